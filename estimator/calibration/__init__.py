"""A rig that nobody has surveyed: its machine file by what driving tells."""
