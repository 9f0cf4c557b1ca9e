"""The scorecard: targets, motions, sensor conditions and seeds through the scanner, judged by the truth.

python -m benchmarks.scorecard --quick
"""
