"""A named point of a robot, as its tool's tip, from a film in which it rests at one place while the robot turns."""
