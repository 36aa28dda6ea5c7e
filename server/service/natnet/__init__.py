"""Poses for programs that read OptiTrack's Motive: its protocol NatNet, as far as rigid bodies need it."""
