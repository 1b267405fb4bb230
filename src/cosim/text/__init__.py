"""What people read: foreign text made harmless, rows as tables."""
