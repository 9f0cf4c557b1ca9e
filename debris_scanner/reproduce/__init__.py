"""The thesis's experiments, simulated, with its method and ours side by side (T24-T26, T29)."""
