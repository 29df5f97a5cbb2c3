"""Every knob of the simulated rig with its unit, bounds and default: what lies under the camera, and how badly."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Shift = Annotated[float, Meta(ge=-5000, le=5000)]
Tilt = Annotated[float, Meta(ge=-30, le=30)]
Radial = Annotated[float, Meta(ge=-100, le=100)]


class SimulationConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The scene, the optics, the noise and the deliberate errors of the simulated rig."""

    object: Literal["stirrup", "dome", "wedge", "flat", "checkerboard"] = "stirrup"
    """What lies on the stage: a stapes-like bone, a sphere cap, a tilted plane, a matt white plate, or a board."""
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 1
    """Chooses texture and noise; everything else equal, the same seed gives the same pictures."""
    colour: bool = True
    """True: RGB frames [h, w, 3]; False: mono [h, w]."""
    bit_depth: Annotated[int, Meta(ge=8, le=16)] = 8
    """Bits per sample: 8 gives uint8, 9 to 16 uint16, right-aligned."""
    time_scale: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    """Factor on simulated durations (motion, exposure, lamp), never on time-outs; 0.1 is ten times as fast."""

    edge_width_um: Annotated[float, Meta(gt=0, le=1000)] = 38.1
    """Standard deviation of the light edge along the travel at best focus, in um (4 frames of 9.525 um)."""
    defocus_um_per_mm: Annotated[float, Meta(ge=0, le=1000)] = 20.0
    """Growth of that width, in um per mm of distance from the focus along the optical axis; 0: sharp everywhere."""
    slide_radius_mm: Annotated[float, Meta(gt=0, le=20)] = 3.81
    """Radius hs of the quarter circle on the slide, in mm (0.15 inch)."""

    albedo_contrast: Annotated[float, Meta(ge=0, le=1)] = 0.15
    """Texture of the surface: relative peak variation of its albedo; 0 is uniform."""
    relief: Annotated[float, Meta(ge=0, le=1)] = 0.12
    """Fine relief of bone and foil: how far shading normals lean, as a tangent; the geometry stays smooth."""
    ambient: Annotated[float, Meta(ge=0, le=1)] = 0.04
    """Room light on a white surface, relative to the lamp at normal incidence."""
    board_ambient: Annotated[float, Meta(ge=0, le=1)] = 0.35
    """The same while a checkerboard lies on the stage: its corners are found by room light."""

    read_noise_counts: Annotated[float, Meta(ge=0, le=50)] = 0.8
    """Standard deviation of the noise in the dark at 6 dB, in counts of 8 bit."""
    full_well_electrons: Annotated[float, Meta(ge=0, le=1e9)] = 20_000.0
    """Electrons at full scale and 0 dB, for shot noise; 0: no shot noise."""
    retake_noise: bool = False
    """True: an exposure that is taken again has other noise (attempt counts); False: the same pixels again."""

    tilt_x_deg: Tilt = 0.0
    """Tilt of checkerboard, flat and wedge about x, in degrees; positive lifts the far side (+y)."""
    tilt_y_deg: Tilt = 0.0
    """Tilt about y, in degrees; positive lifts the left side (-x), toward the projector."""
    yaw_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    """Turn of checkerboard and wedge about z, in degrees, counter-clockwise as the camera sees it."""
    board_square_mm: Annotated[float, Meta(gt=0, le=5)] = 0.3
    """Side of a square of the checkerboard in mm."""
    board_columns: Annotated[int, Meta(ge=2, le=200)] = 16
    """Squares of the checkerboard along x."""
    board_rows: Annotated[int, Meta(ge=2, le=200)] = 13
    """Squares of the checkerboard along y."""
    board_thickness_mm: Annotated[float, Meta(ge=0.05, le=5)] = 0.5
    """Thickness of the board: z = 0 is its pattern lying flat, the black foil of the stage lies so far below."""

    specimen_moved_um: tuple[Shift, Shift, Shift] = (0.0, 0.0, 0.0)
    """Displacement x, y, z of the object (not of the stage) from its place, in um."""
    rehome_error_steps: Annotated[int, Meta(ge=-100_000, le=100_000)] = 0
    """Microsteps by which the projector stands further than its position says, as after a bad homing."""

    camera_distance_mm: Annotated[float, Meta(ge=20, le=1000)] = 76.88
    """Distance of the camera's pinhole from the middle of the field, in mm; the field of view grows with it."""
    distortion: tuple[Radial, Radial, Radial, Radial, Radial] = (-0.3, 0.0, 0.0, 0.0, 0.0)
    """Lens distortion k1 k2 p1 p2 k3 (OpenCV); k1 = -0.3 moves the image's far corner by about two pixels."""

    faults: Annotated[str, Meta(max_length=4000)] = ""
    """Faults of camera and lamp by script, for tests: verb:exposure,... such as "lose:12,dim:200"; empty is none."""
