"""Shows a driver a calibration while it is driven; it hears Zenoh only."""
