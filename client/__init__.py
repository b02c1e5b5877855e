"""For controllers: what the daemon publishes, heard over Zenoh, with a rule for what is too old to use."""
