"""Prompts a driver through a plan of experiments. It hears a daemon and marks its log; it never steers."""
