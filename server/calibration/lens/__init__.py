"""The camera's lens, from views of a flat board."""
