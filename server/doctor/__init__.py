"""What a few seconds of frames say of the camera, its lens, the light and the rig: the checks of `asterism doctor`."""
