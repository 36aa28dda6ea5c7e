"""The camera of rigs that are mutated, as the text of its file."""

CAMERA = """\
image_width: 640
image_height: 512
camera_name: top
camera_matrix: {rows: 3, cols: 3, data: [700.0, 0.0, 319.5, 0.0, 700.0, 255.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}
"""
