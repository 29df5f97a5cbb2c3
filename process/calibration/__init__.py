"""Calibration of camera and light plane, with uncertainties; writes calibration.json.

Each method has a folder. Its entry function returns a result with ``document()``, the ``camera`` or ``light_plane``
object of calibration.json, and ``lines()``, the result as text. To add a method: a folder with such a result, and a
command in ``tui/commands/calibrate`` that ends in ``save``.

| method | entry function | result | | --- | --- | --- | | camera from pictures of a board (equation 1) |
``camera.calibrate.calibrate_camera`` | ``CameraResult`` | | light plane from sweeps over boards |
``light_plane.from_sweeps.fit_plane`` (``recipe.make_plane`` from files) | ``PlaneResult`` | | light plane from the
slide's quarter circle (equations 5 to 10, 15) | ``quarter_circle.calibrate.find_quarter_circle``,
``quarter_circle.clicks.plane_from_clicks`` | ``QuarterCircle`` | | one plane per frame from two reference planes |
``reference_planes.calibrate.fit_reference_planes`` | ``ReferenceResult`` | | files of the original program |
``original_program.light_plane`` | its ``light_plane`` object |
"""
