"""The published method, step by step as it was: Trowbridge 2014, with its errata corrected.

Everything here is selectable beside the product's own method and shares its types (TargetFrame, Model,
StampedPose); nothing here is used by the scanner itself. ``pipeline`` runs it end to end.
"""
