"""Tests, and the benchmark (`python -m tests.bench`)."""
