"""What every other program needs to talk to Asterism: formats, messages, keys, codec, network settings.

| frame  | origin                       | axes                        | unit |
|--------|------------------------------|-----------------------------|------|
| image  | centre of the top-left pixel | x right, y down             | px   |
| camera | optical centre               | x right, y down, z forward  | m    |
| world  | the user's choice (rig.yaml) | right-handed, z up          | m    |
| robot  | the user's choice (rig.yaml) | right-handed                | m    |

`T_a_b` maps points of frame b into frame a: ``p_a = T_a_b @ p_b``. Quaternions are x y z w with w >= 0.
Times are integer nanoseconds since the Unix epoch. README.md beside this file is enough to write a client in
another language.
"""
