"""Reading SSP files: their entries, elements, connections and parameters."""
