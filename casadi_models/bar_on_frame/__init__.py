"""Slender bar pinned at G to the horizontal arm OG of a frame that turns in two bearings.

    B        k   F: (n1, n2, k) turns about the vertical k by phi at the prescribed rate Omega;
    |        ^      n1 and n2 are the world's X and Y at phi = 0; A is the bottom bearing (with
    O----G   |      the drive), B the top one, O the weld of column AB and arm OG = d n2.
    |        +>  Bar: (e1, n2, e3) turns about n2 relative to F by the free angle theta;
    A        n2     e1 = C n1 - S k is its long axis, theta = 0 is horizontal.

Model   gravity off; bar slender; bearings slide along k; damper and torque T2 act in the pin, so
        that the frame bears their reaction: t2_G = T2 - b theta_dot is the book's T2.
        frame_inertia = 0 makes the frame massless (the book's "light"), 1 gives it its mass.
Source  Unit 7, Example 2; equations from Units 2 (U2) and 4 (U4).
"""
