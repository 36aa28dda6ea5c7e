"""serve's loop: publishing, health, threads, live views."""
