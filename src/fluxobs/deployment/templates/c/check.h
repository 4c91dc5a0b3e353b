/* Replays the test vectors and compares the results with those of the fluxobs library. Runs on the
 * target as well: no input, no output, about 70 KB of constants. */
#ifndef CHECK_H
#define CHECK_H

#ifdef __AVR__
#error "the record is larger than an array can be on an AVR, which is too slow for the observer"
#endif

#include "@header@"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    int damaged;       /* the vectors are not those that were written */
    int rows;          /* compared */
    int wrong;         /* of them */
    int first_row;     /* the first wrong sample, ... */
    int first_column;  /* ... and which value of it; see vectors.h */
    int between;       /* all these are right, but some sample between them is not */
    int valid;         /* rows whose position is known */
    double flux_error; /* largest, relative */
    double angle_error; /* largest [rad] */
} check_result;

/* Every output must be equal bit for bit. The sources use nothing of a C library that may round in
 * its own way, but the compiler must not fuse a multiplication and an addition: -ffp-contract=off. */
void check_replay(check_result *result);

#ifdef __cplusplus
}
#endif

#endif
