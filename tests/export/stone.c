/* Follow a throw with the exported stone: vx, vy, omega and the length of a step. */
#include <stdio.h>
#include <stdlib.h>
#include "curlfit_stone.h"

int main(int count, char **words)
{
    double a[3];
    curlfit_stone s;
    if (count != 5) return 2;
    s.x = 0.3, s.y = 1.0, s.vx = atof(words[1]), s.vy = atof(words[2]), s.phi = 0.0;
    s.omega = atof(words[3]);
    curlfit_accelerations(0.7, s.omega, a);
    while (curlfit_step(&s, atof(words[4]), 1.0)) continue;
    printf("%.12g %.12g %.12g %.12g %.12g %.12g %g\n", a[0], a[1], a[2], s.x, s.y, s.phi,
           fabs(s.vx) + fabs(s.vy) + fabs(s.omega));
    return 0;
}
