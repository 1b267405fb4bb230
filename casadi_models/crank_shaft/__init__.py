"""Crank shaft S, seven welded slender bars, turning about Z in two bearings A and B.

         +--+          Z ->        S: (X', Y', Z) turns about Z by phi; the path of the bars
    A ---+  |  +--- B              lies in the plane X'Z, bar 4 is twice as long;
            +--+                   G lies midway between A (origin) and B on the axis.

Model   bars slender (no inertia about their own axis), bearings slide along Z, drive torque at A.
Source  Unit 7, Example 1; equations from Unit 2.
"""
