"""What the scanner costs, stage by stage and live, beside its peers; ``python -m benchmarks.performance``."""
