"""Parameters that the nodes declare for themselves, so that a file for all of them may name them.

A test compares this with what the nodes declare.
"""

_CAMERA = (
    'colour',
    'cx',
    'cy',
    'device',
    'frame_id',
    'fx',
    'fy',
    'library',
    'max_rate_hz',
    'registered',
    'rgb_frame_id',
    'wait_for_stages',
    'wait_for_subscribers',
)

NODES: dict[str, tuple[str, ...]] = {
    'preprocess': ('autostart', 'input', 'input_depth', 'input_reliability', 'journal_dir'),
    'odometry': (
        'autostart',
        'journal_dir',
    ),
    'closure': (
        'autostart',
        'journal_dir',
    ),
    'graph': (
        'autostart',
        'exit_after_idle',
        'finish_after_idle',
        'journal_dir',
        'max_mesh_triangles',
        'output_dir',
    ),
    'scanner': (
        'autostart',
        'exit_after_idle',
        'finish_after_idle',
        'input',
        'input_depth',
        'input_reliability',
        'max_mesh_triangles',
        'output_dir',
    ),
    'sim_kinect': (
        'axis_sensor',
        'clutter',
        'colour',
        'correlated',
        'frame_id',
        'gaps',
        'gaps_from_s',
        'leaves_s',
        'mli',
        'motion',
        'noise',
        'patchy',
        'range_m',
        'rate_hz',
        'seconds',
        'seed',
        'size',
        'spin_rad_s',
        'stay',
        'target',
        'truth_dir',
        'wait_for_stages',
        'wait_for_subscribers',
    ),
    'play_bag': ('bag', 'loops', 'rate', 'stay', 'topic', 'wait_for_stages', 'wait_for_subscribers'),
    'openni2_camera': tuple(sorted((*_CAMERA, 'height', 'repeat', 'width'))),
    'freenect_camera': _CAMERA,
    'viewer': ('host', 'max_points', 'max_rate_hz', 'port'),
}
