/* Replays the test vectors and compares the results with those of the fluxobs library. This check
 * also runs on the target, with no input or output and about 70 KB of constants. */
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
    int damaged;       /* the vectors differ from the exported vectors */
    int rows;          /* number of compared samples */
    int wrong;         /* number of compared samples that differ */
    int first_row;     /* first wrong sample, ... */
    int first_column;  /* ... and the first wrong column of it; see vectors.h */
    int between;       /* all compared samples are right, but a sample between them is wrong */
    int valid;         /* rows with a valid position */
    double flux_error; /* largest, relative to the flux */
    double angle_error; /* largest [rad] */
} check_result;

/* Every output must be equal bit for bit. The sources call no function of the C library that may round
 * differently, but the compiler must not fuse multiplications and additions: -ffp-contract=off. */
void check_replay(check_result *result);

#ifdef __cplusplus
}
#endif

#endif
