"""The rig of designed plates, as text: rig.yaml, and a camera.yaml that stands in until there is a calibrated one."""

from asterism.server.design.plate_design import FOCAL_PX, HEIGHT_PX, LIGHT_RADIUS, WIDTH_PX, Design


def rig_text(design: Design) -> str:
    """rig.yaml of the plates, the origin of every robot at its plate's centre."""
    asked = design.request
    lines = [
        f"# Made by: asterism design --robots {asked.robots} --disc {asked.disc:g} --spacing {asked.spacing:g} "
        f"--distance {asked.distance:g} --sigma {asked.sigma_px:g}",
        "camera: camera.yaml                 # nominal: put your calibrated camera's file in its place",
        f"range: [{asked.distance / 2:g}, {asked.distance:g}]                  # working distances, m",
        "# led.radius suits bare LEDs of 5 mm, clear or frosted; behind a diffuser it is that of the hole.",
        "robots:",
    ]
    for name, layout in zip(design.names, design.layouts.tolist(), strict=True):
        lines += [f"  {name}:", "    leds:                           # m, from the plate's centre; z: where they shine"]
        lines += [f"      - [{x:.5f}, {y:.5f}, 0.0]" for x, y in layout]
        lines.append(f"    led: {{radius: {LIGHT_RADIUS:g}}}           # m, of the light, not of the plastic")
    return "\n".join(lines) + "\n"


def camera_text() -> str:
    """camera_info of the camera that the plates were designed for: no distortion, the principal point in the middle."""
    x, y = (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2
    return f"""\
# Nominal, not calibrated: a stand-in until there is a calibrated camera. Poses from it are wrong.
image_width: {WIDTH_PX}
image_height: {HEIGHT_PX}
camera_name: nominal
camera_matrix:
  rows: 3
  cols: 3
  data: [{FOCAL_PX}, 0.0, {x}, 0.0, {FOCAL_PX}, {y}, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.0, 0.0, 0.0, 0.0, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [{FOCAL_PX}, 0.0, {x}, 0.0, 0.0, {FOCAL_PX}, {y}, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
