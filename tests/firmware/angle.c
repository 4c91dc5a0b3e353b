/* Compares fo_atan2 with the C library's atan2 in extended precision. Prints a hash of the bits of
 * fo_atan2, which must be the same with every compiler. */
#include <stdio.h>
#include <string.h>

#include "fluxobs_internal.h"

static unsigned long long seed = 1;

static double uniform(void) /* -1 to 1 */
{
    seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(seed >> 33) / 1073741824.0 - 1.0;
}

int main(void)
{
    const long double most = sizeof(fo_real) == sizeof(float) ? 4e-7L : 4.5e-16L;
    const double scales[] = {1.0, 1e-4, 1e-9, 1e6};
    unsigned long long hash = 14695981039346656037ULL;
    int failed = 0;
    for (int n = 0; n < 2000000; n++) {
        const fo_real y = (fo_real)(uniform() * scales[n % 4]);
        const fo_real x = (fo_real)(uniform() * scales[n / 4 % 4]);
        const fo_real found = fo_atan2(y, x);
        const long double right = atan2l((long double)y, (long double)x);
        /* relative error for small angles, which are as exact as their ratio */
        const long double allowed = most * (fabsl(right) < 1.0L ? fabsl(right) : 1.0L);
        if (!(fabsl((long double)found - right) <= allowed)) {
            failed = 1;
            printf("atan2(%.17g, %.17g) = %.17g\n", (double)y, (double)x, (double)found);
        }
        unsigned char bytes[sizeof found];
        memcpy(bytes, &found, sizeof found);
        for (size_t k = 0; k < sizeof bytes; k++) {
            hash = (hash ^ bytes[k]) * 1099511628211ULL;
        }
    }
    const fo_real pi = (fo_real)3.14159265358979323846, one = 1, zero = 0;
    failed |= fo_atan2(zero, zero) != zero || fo_atan2(zero, one) != zero;
    failed |= fo_atan2(zero, -one) != pi || fo_atan2(one, zero) != pi / 2;
    failed |= fo_atan2(-one, zero) != -pi / 2 || fo_atan2(one, one) != pi / 4;
    failed |= !isnan(fo_atan2((fo_real)NAN, one)) || !isnan(fo_atan2(one, (fo_real)NAN));
    printf("%016llx\n", hash);
    return failed;
}
