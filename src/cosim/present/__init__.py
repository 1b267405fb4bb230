"""Pictures of runs: figures, playback, reports."""
