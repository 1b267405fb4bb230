"""The machine below: temporary folders, processes that are gone."""
