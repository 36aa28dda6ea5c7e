"""Where frames come from. Every source is an iterator of Frames with `exposed_ns`.

Files have the times that stand beside them, or count from 0 at their own rate, and lose nothing; `paced` plays them
against the clock. Cameras are live: the newest frame wins, what it replaces is counted, and a camera that vanishes is
waited for.
"""
