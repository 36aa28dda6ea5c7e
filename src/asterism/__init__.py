"""One camera, several robots with six LEDs each: where is every robot, in every frame, and how sure are we.

`asterism.server` is the chain and its command line, `asterism.protocol` what other programs need, `asterism.clients`
what runs on robots and desks, `asterism.recordings` what writes and reads recordings.
"""

__version__ = "0.2.0"
