"""What the warm-up spares the first real frame."""

import inspect

from debris_scanner import odometry
from debris_scanner.warm_up import warm_up


def test_a_logger_need_not_look_at_all_modules_any_more():
    warm_up()
    assert inspect.modulesbyfile[odometry.__file__] == odometry.__name__
