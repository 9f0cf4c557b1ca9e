"""The ``debris-scan`` command and its verbs."""
