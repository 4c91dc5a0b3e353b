/* Runs the observer on this computer and compares it with the fluxobs library. */
#include <float.h>
#include <stdio.h>

#include "check.h"

int main(void)
{
    static const char *const columns[] = {@columns@};
    const char *precision = sizeof(fo_real) == sizeof(float) ? "single" : "double";
    check_result r;
    check_replay(&r);
    printf("%s: %d of %d rows as expected, %d with a valid position; flux within %.1e, angles "
           "within %.1e rad\n",
           precision, r.rows - r.wrong, r.rows, r.valid, r.flux_error, r.angle_error);
    if (r.damaged) {
        printf("FAILED: the values in vectors.h are not those that were written\n");
    }
    if (r.wrong > 0) {
        printf("FAILED: first at sample %d: %s\n", r.first_row, columns[r.first_column]);
#if FLT_EVAL_METHOD != 0
        printf("This compiler computes in a wider type than is stored; on x86 try -msse2 "
               "-mfpmath=sse\n");
#endif
    }
    if (r.between) {
        printf("FAILED: a sample between those listed is not as expected\n");
    }
    if (r.valid == 0) {
        printf("FAILED: no position is ever known\n");
    }
    return r.damaged || r.wrong > 0 || r.between || r.valid == 0 ? 1 : 0;
}
