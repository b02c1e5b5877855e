"""`tilth calibrate` at the desk: logs in, a machine file and a report out."""
