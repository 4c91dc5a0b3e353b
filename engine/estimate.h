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

/* Machine file: values, and relative standard deviations (logarithms); a std of zero is exact. With a flux map, L_d
 * and L_q are its scales. Of the errors of a drive: standard deviations; zero: it has none. */
#define FO_FILE_FIELDS(NUMBER)                                                                  \
    NUMBER(R)              /* [Ω]                                                            */ \
    NUMBER(L_d)            /* [H] or [1]                                                     */ \
    NUMBER(L_q)                                                                                 \
    NUMBER(psi_f)          /* of magnets [Wb]                                                */ \
    NUMBER(guessed)        /* 1: psi_f is not stated, but guessed from the log               */ \
    NUMBER(rated_current)  /* [A]                                                            */ \
    NUMBER(R_std)                                                                               \
    NUMBER(L_d_std)                                                                             \
    NUMBER(L_q_std)                                                                             \
    NUMBER(psi_std)                                                                             \
    NUMBER(flux)           /* that usually turns with the rotor [Wb]                         */ \
    NUMBER(R_R)            /* of a cage [Ω]; else 0                                          */ \
    NUMBER(L_M)            /* of a cage [H]; else 0                                          */ \
    NUMBER(R_R_std)                                                                             \
    NUMBER(L_M_std)                                                                             \
    NUMBER(loss)           /* inverter's, of a phase; 0: an ordinary one [V]                 */ \
    NUMBER(loss_std)                                                                            \
    NUMBER(harmonics)      /* scale of the harmonics' coefficients, as a share of the flux   */ \
    NUMBER(lag)            /* by which the voltages act later than the log says [samples]    */ \
    NUMBER(lag_std)                                                                             \
    NUMBER(rotation)       /* share of the turn of the voltage that it makes within a row [1] */ \
    NUMBER(rotation_std)                                                                        \
    NUMBER(delay_std)      /* by which the currents are older than the log says [samples]    */ \
    NUMBER(iron_std)       /* current of the iron loss per induced voltage [A/V]             */ \
    NUMBER(heat_std)       /* relative change of R over the log [1]                          */ \
    NUMBER(offset_std)     /* of a component of the current [A]                              */ \
    NUMBER(gain_std)       /* unequal gains of the current sensors [1]                       */ \
    NUMBER(saturation_std) /* share of its flux that the rated current loses [1]             */

typedef struct {
#define FO_FILE_NUMBER(name) double name;
    FO_FILE_FIELDS(FO_FILE_NUMBER)
#undef FO_FILE_NUMBER
    const fo_map *map; /* null: constant inductances */
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
