"""A frame's way, step by step: frame in, FrameResult out, and its messages."""
