/* A log with fewer rows, for the first steps of learning. */
#ifndef FLUXOBS_THINNING_H
#define FLUXOBS_THINNING_H

#include "innovations.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Every n-th current, and the mean voltages between them: the flux still takes the whole voltage, so the
 * model is the same, and only the currents between are lost. */
typedef struct {
    fo_log log;
    size_t factor; /* n */
    long shift;    /* rows by which its voltages are later than those of the log */
    double *values; /* that belong to it; null: none */
} fo_thinned;

/* How many rows one row of the thinned log may replace, a power of two: the rotor turns little within it, and the
 * current decays little. 1: the log is short, or slowly sampled. `angle`: of the rotor, a number for each row;
 * `decay`: R/L, the inverse of the current's time constant [1/s]. */
size_t fo_thinning(const fo_log *log, const double *angle, double decay);

/* False: no memory. The voltages of the log act `lag` rows later than it says. */
bool fo_thin(const fo_log *log, size_t factor, double lag, fo_thinned *out);
void fo_free_thinned(fo_thinned *thinned);

/* Cubic interpolation of a course at the rows of a thinned log; flux in rotor coordinates. */
void fo_fill(const fo_course *thinned, size_t count, size_t factor, fo_course *out, size_t rows);

#ifdef __cplusplus
}
#endif
#endif
