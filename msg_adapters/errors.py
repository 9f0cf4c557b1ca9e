"""The errors that readers of messages and bags raise."""


class MalformedMessage(ValueError):
    """A message that contradicts itself, or lacks what it is read for; the text names the thing."""


class BagError(ValueError):
    """A bag that cannot be read or written at all; the text is one line that names the thing."""
