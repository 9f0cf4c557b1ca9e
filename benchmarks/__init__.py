"""Programs that measure: how good the scans are, what they cost, how biased a registration is."""
