"""Drawings of mechanisms: poses, meshes, camera, pictures and diagrams."""
