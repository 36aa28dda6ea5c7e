"""serve's loop: publishing, health, threads, live views, and what it says of how it goes."""
