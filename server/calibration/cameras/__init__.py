"""Where several cameras stand, from robots that two or more of them see."""
