"""Watch a rotating object with a depth sensor, close the loop, build its model, track it."""

__version__ = '0.1.0'
