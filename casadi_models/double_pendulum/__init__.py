r"""Three-dimensional double pendulum: two equal links on ball joints at O (ground) and A.

      O          N: (X, Y, Z) world, Z up, origin O.
     / 1         L1, L2: (x, y, z) fixed in links 1 and 2, which point from their upper joint
    A            along -z, so that both frames are N when the pendulum hangs.
     \ 2         G1, G2: mass centers, midway; the tip is the free end of link 2.

Model   links axisymmetric, joints on their axes and without friction, gravity along -Z. Speeds in
        every formulation are the angular velocities w1 and w2, resolved in L1 and L2.
Source  Unit 7, Exercises 7.2 to 7.4; docs/double_pendulum.md holds the derivation.
"""
