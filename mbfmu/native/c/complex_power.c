/* What numba calls for a power of a complex number; of the numbers here the imaginary part is far smaller than the real
   one. */

#include <math.h>

typedef struct {
    double re, im;
} Complex;

void numba_cpow(const Complex *base, const Complex *power, Complex *result);

void numba_cpow(const Complex *base, const Complex *power, Complex *result)
{
    double size = hypot(base->re, base->im), angle = atan2(base->im, base->re);
    double length = size > 0.0 ? pow(size, power->re) * exp(-power->im * angle) : power->re == 0.0 && power->im == 0.0;
    double turn = size > 0.0 ? power->re * angle + power->im * log(size) : 0.0;
    result->re = length * cos(turn);
    result->im = length * sin(turn);
}
