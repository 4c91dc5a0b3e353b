/* Estimate every row of a log in memory, in both directions, with its error budget. */
#ifndef FLUXOBS_ESTIMATE_H
#define FLUXOBS_ESTIMATE_H

#include "learn.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Outputs of a row. */
#define FO_SMOOTHED_FIELDS(NUMBER)                                                             \
    NUMBER(flux_alpha)      /* [Wb]                                                         */ \
    NUMBER(flux_beta)                                                                          \
    NUMBER(flux_alpha_std)                                                                     \
    NUMBER(flux_beta_std)                                                                      \
    NUMBER(psi_f)           /* magnet flux, rotor flux, or size of the auxiliary flux [Wb]  */ \
    NUMBER(psi_f_std)                                                                          \
    NUMBER(theta_e)         /* [rad]                                                        */ \
    NUMBER(theta_e_std)                                                                        \
    NUMBER(speed_e)         /* [rad/s]                                                      */ \
    NUMBER(speed_e_std)                                                                        \
    NUMBER(torque)          /* flux × current [W s]; times 1.5 n_p                          */ \
    NUMBER(torque_std)                                                                         \
    NUMBER(drift_alpha)     /* [V]                                                          */ \
    NUMBER(drift_beta)                                                                         \
    NUMBER(drift_std)                                                                          \
    NUMBER(resistance)      /* [Ω]                                                          */ \
    NUMBER(resistance_std)                                                                     \
    NUMBER(innovation)      /* of the row's block, divided by its std                       */ \
    NUMBER(misfit)          /* mean square of the innovations around the row                */ \
    NUMBER(doubtful)        /* 1: the row or its neighbours do not fit                      */

#define FO_SMOOTHED_INDEX(name) FO_S_##name,
enum { FO_SMOOTHED_FIELDS(FO_SMOOTHED_INDEX) FO_S };
#undef FO_SMOOTHED_INDEX

/* Quantities of a block with a budget: angle [rad], speed [rad/s], a component of the flux [Wb],
 * flux × current [W s]. */
enum { FO_OF_ANGLE, FO_OF_SPEED, FO_OF_FLUX, FO_OF_TORQUE, FO_QUANTITIES };
/* Variance of a quantity: a share of each assumption, then the smoother's, then that of the noise
 * of the current at the row itself. */
enum { FO_BUDGET_SMOOTHER = FO_P, FO_BUDGET_NOISE, FO_BUDGET };

typedef struct {
    double *columns;  /* FO_S * rows, column by column */
    uint8_t *known;   /* rows: measured, long enough, and fits */
    double *budget;   /* blocks * FO_QUANTITIES * FO_BUDGET, or null */
} fo_estimates;

/* Rows of a block of a log of this model. */
size_t fo_rows_per_block(const fo_model *m);
size_t fo_blocks_of(const fo_model *m, size_t rows);

/* `learnt->p` is where learning starts, or with `learning` false, what is assumed. False: no
 * memory, or stopped. */
bool fo_estimate_rows(const fo_model *m, const fo_record *r, bool learning, fo_assumed *learnt,
                      const fo_estimates *out);

#ifdef __cplusplus
}
#endif
#endif
