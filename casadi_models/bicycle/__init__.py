r"""Upright bicycle of four rigid bodies on a plane; the wheels are thin and roll without slip.

                 B                N1 forward, N2 to the right, N3 down; origin at the start of P.
             G_B o \
                   \ S           A rear wheel, B rear frame with rider, C fork, D front wheel
           A        \ C  D       yaw psi, roll phi, pitch theta (3-1-2) turn N into B,
         ( o )-------\( o )      tilt lambda and steer delta turn B into C (2-3),
     ______P__________\_Q_____   thetaR and thetaF turn the wheels; forward they are negative.
            <-- w -->  <c>

Independent are phi, thetaR, delta. The pitch follows from the front wheel's contact, the rates of
psi, theta, thetaF from rolling. Three formulations:

  independent  dependent speeds eliminated: explicit ODE, 11 states;
  book         the book's 15 states and algorithm, in stages (`stages`, `book.constants`);
  multipliers  six speeds and the front contact force: index-1 DAE, regular at every steer angle.

The first two end where the front wheel stands across the line PQ, near |delta| = 91.8 deg. Forces
are those of the ground on the wheels along N1, N2, N3: a supporting force has a negative z.

Source  Unit 7, Example 3 (equations of Unit 5). Parameters: Meijaard, Papadopoulos, Ruina, Schwab,
        Proc. R. Soc. A 463, 2007, doi:10.1098/rspa.2007.1857.
"""
