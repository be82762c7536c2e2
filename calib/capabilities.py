"""Entry points of the capabilities, in the groups that other packages use as well.

The core asks `calib.core.base.registry` for the entries of a group, and imports no capability. An entry is loaded when
it is first used.
"""

from importlib.metadata import EntryPoint

ENTRY_POINTS = tuple(
    EntryPoint(name, value, group)
    for group, name, value in (
        ("calib.parametrisations", "linear_delta", "calib.printers.linear_delta:LinearDelta"),
        ("calib.formats", "exporting", "calib.exporting.file_formats:FORMATS"),
        ("calib.kinds", "height", "calib.printers.height:Height"),
        ("calib.formats", "printers", "calib.printers.file_formats:FORMATS"),
        ("calib.formats", "more", "calib.exporting.file_formats:MORE_FORMATS"),
        ("calib.methods", "export", "calib.exporting.formats:export"),
        ("calib.methods", "bags", "calib.files.rosbag"),
        ("calib.methods", "photographs", "calib.photographs.rendering:photographs"),
        ("calib.methods", "select", "calib.planning.selection:select"),
        ("calib.methods", "shortest_order", "calib.planning.measurement_order:shortest_order"),
        ("calib.methods", "compiled_kinematics", "calib.compiled.kernels"),
        ("calib.methods", "check_poses", "calib.motion.poses:check_poses"),
        ("calib.methods", "urdf_of_table", "calib.starting.dh_tables:urdf_of_table"),
        ("calib.methods", "with_model", "calib.fleets.atlas:with_model"),
        ("calib.methods", "templates", "calib.starting.templates:TEMPLATES"),
        ("calib.measures", "camera", "calib.photographs.first_words:camera_words"),
        ("calib.first_descriptions", "klipper", "calib.printers.first_files:KLIPPER"),
        ("calib.first_descriptions", "marlin", "calib.printers.first_files:MARLIN"),
        ("calib.first_descriptions", "duet", "calib.printers.first_files:DUET"),
        ("calib.models", "universal robots", "calib.fleets.atlas:MODELS"),
        ("calib.readers", "programs", "calib.files.formats:FORMATS"),
        ("calib.robot_readers", "yaml", "calib.fleets.ur_kinematics:read_ur"),
        ("calib.robot_readers", "mujoco", "calib.files.mjcf_reading:read_mjcf"),
        ("calib.robot_readers", "sdf", "calib.files.sdf_reading:read_sdf"),
        ("calib.robot_readers", "xacro", "calib.files.xacro_files:read_xacro"),
        ("calib.parametrisations", "rotary_axes", "calib.redundancy.rotary_axes:rotary_axes"),
        ("calib.formats", "rotary axes", "calib.redundancy.rotary_axes:FORMATS"),
        ("calib.parametrisations", "altaz", "calib.redundancy.altaz:altaz"),
        ("calib.terms", "tube_flexure", "calib.redundancy.altaz:TubeFlexure"),
        ("calib.kinds", "sighting", "calib.redundancy.sighting:Sighting"),
        ("calib.kinds", "pointing", "calib.redundancy.pointing:Pointing"),
        ("calib.kinds", "cable", "calib.redundancy.cable:Cable"),
        ("calib.reasons", "negative_spool", "calib.redundancy.cable:check_spools"),
        ("calib.kinds", "hole_pattern", "calib.redundancy.hole_pattern:HolePattern"),
        ("calib.reasons", "between_holes", "calib.redundancy.hole_pattern:check_holes"),
        ("calib.terms", "play", "calib.redundancy.drive_terms:Play"),
        ("calib.terms", "in_proportion", "calib.redundancy.drive_terms:InProportion"),
        ("calib.entries", "traceability", "calib.quality.traceability:TraceabilitySection"),
        ("calib.entries", "obstacles", "calib.motion.surroundings:Obstacles"),
        ("calib.entries", "shape", "calib.motion.surroundings:ShapeSection"),
        ("calib.entries", "acceptance", "calib.motion.surroundings:Acceptance"),
        ("calib.entries", "sight", "calib.motion.surroundings:SightSection"),
        ("calib.contradicted", "fleet", "calib.fleets.contradicted_prior:without_contradicted_fleet"),
    )
)
"""Entries in the order in which commands and messages list them."""
