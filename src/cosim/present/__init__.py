"""Presentation of runs and studies: figures, playback, reports."""
