"""Playback of runs in three dimensions."""
