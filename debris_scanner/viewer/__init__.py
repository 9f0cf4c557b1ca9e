"""The scan in a browser, while it runs; no ROS here."""
