/* Angle, speed and parameters of a whole log of a synchronous machine. */
#ifndef FLUXOBS_ESTIMATE_H
#define FLUXOBS_ESTIMATE_H

#include "posterior.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    FO_ESTIMATED,
    FO_NO_ESTIMATE, /* no parameters that a machine may have explain enough of the log */
    FO_NO_MEMORY
} fo_outcome;

/* Machine file: values, and relative standard deviations (logarithms); a std of zero is exact. */
typedef struct {
    double R, L_d, L_q, psi_f, rated_current; /* with a flux map: L_d and L_q are its scales */
    double R_std, L_std, psi_std;
    const fo_map *map; /* null: constant inductances */
    double flux;       /* that usually turns with the rotor [Wb] */
    double R_R, L_M;   /* of a cage [Ω], [H]; else 0 */
    double cage_std;   /* of both */
    double lag, lag_std; /* that the voltages act later than the log says [samples] */
    /* Errors that a drive may have; 0: it has none. */
    double delay_std;  /* the currents are older than the log says [samples] */
    double iron_std;   /* current of the iron loss per induced voltage [A/V] */
    double heat_std;   /* relative change of R over the log [1] */
    double offset_std; /* of a component of the current [A] */
    double gain_std;   /* unequal gains of the current sensors [1] */
    double saturation_std; /* share of its flux that the rated current loses [1] */
} fo_file;

/* Variance that rounding adds to each row's noise [A²]. While the reading does not change, its error does
 * not either: a run of n equal readings tells as much as one, whose error is uniform over the step with
 * which it ends. So do currents that the logger holds, and a sensor that is stuck for a while. */
void fo_rounding_of(const fo_log *log, double *rounding);

/* Priors of an ordinary drive. The levels scale with the log's mean voltage and the rated current. */
fo_prior fo_ordinary_prior(const fo_log *log, const fo_file *file);

/* Estimates a log from angles that an observer gives: `angles` has a number for each row, NaN where it knows none.
 * `sure`: the observer calls these rows valid. The longest run that gives parameters which a machine may have is
 * believed within about half a radian; if it is not sure, these parameters must explain as many other rows. Rows whose
 * currents nothing explains have an angle of NaN, and no shares. `parameters`: where learning starts, an array of
 * FO_UNKNOWNS or null; a parameter that is NaN starts at the mean of its prior. */
fo_outcome fo_estimate_log(const fo_log *log, const fo_file *file, const double *angles, bool sure,
                           const double *parameters, fo_posterior *posterior, const fo_estimates *estimates);

#ifdef __cplusplus
}
#endif
#endif
