"""The live page of the cab: a process of its own that hears Zenoh and serves a browser on this machine."""
