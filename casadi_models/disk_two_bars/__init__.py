r"""Two bars hinged end to end below a disk that turns at a constant rate, with springs and dampers.

    ---+-----  disk     D: (e1, e2, e3) turns with the disk about the vertical e3 by phi; e2 points
       |   |H1          from the axis to hinge H1, e1 = e2 x e3 is the axis of both hinges; H1 lies
    e3 ^    \  bar 1    hinge_drop below the disk's plane.
       |     \H2     Bar i: (e1, b2, b3) turns about e1 by theta_i from D, positive outward; it
       +->    \         points along -b3 and hangs at theta_i = 0.
         e2    \  bar 2

Model   disk thin, bars solid cylinders; spring and damper 1 act between disk and bar 1 on theta1,
        2 between the bars on theta2 - theta1; gravity along -e3, zero energy in the disk's plane.
        The source's figure is lost: hinges and springs are placed as assumed here.
Source  Unit 7, Exercise 7.1.
"""
