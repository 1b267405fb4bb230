"""Tools that make equations of motion: Kane's method, rotations, joints, condition monitors."""
