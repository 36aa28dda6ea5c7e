"""The surface that robots drive on, from their poses."""
