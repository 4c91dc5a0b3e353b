/* fluxobs, the adaptive observer: starts within a fraction of a turn at an unknown angle, finds
 * errors of resistance and inverter, returns the magnet's flux, and models saliency.
 *
 * The observer of fluxobs.h runs inside, unchanged. Until the position is known, its information is
 * projected on the manifold of consistent (flux, drift, magnet flux). Then a recursive square-root
 * Gauss-Newton filter on (flux, drift, magnet flux, resistance error, inverter voltage) takes over,
 * guarded by the observer inside (docs/theory.md, section 13).
 *
 * For machines with Q1 = 1, E = 0: |flux - L i| = psi_f + saliency i_d.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_ADAPTIVE_H
#define FLUXOBS_ADAPTIVE_H

#include "fluxobs.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifdef FO_SINGLE
#define fo_adaptive_init fo_adaptive_init_single
#define fo_adaptive_reset fo_adaptive_reset_single
#define fo_adaptive_step fo_adaptive_step_single
#define fo_adaptive_step_volt_seconds fo_adaptive_step_volt_seconds_single
#endif

enum {
    FO_NP = 2 * FO_N + 3,                     /* flux, drift, magnet flux, resistance, inverter   */
    FO_NP_TRIANGLE = FO_NP * (FO_NP - 1) / 2, /* packed strict upper triangle, column by column   */
    FO_NM = 2 * FO_N + 1,                     /* the manifold: flux, drift, square of magnet flux */
    FO_CANDIDATES = 4                         /* positions followed at the start                  */
};

/* When the information is projected on the manifold. */
typedef enum {
    FO_PROJECT_NEVER, /* the start waits for the plain observer's position         */
    FO_PROJECT_START, /* until the position is known                               */
    FO_PROJECT_ALWAYS /* also afterwards, when the projection is the filter's guard */
} fo_projection;

/* Assumed values of machine and inverter, and their standard deviations, 0 if known; then when the
 * information is projected. */
#define FO_ADAPTIVE_CONFIG_FIELDS(NUMBER)                                                        \
    NUMBER(saliency)         /* L_d - L_position [H]                                          */ \
    NUMBER(psi_f)            /* magnet flux [Wb]; 0 without magnets, ...                      */ \
    NUMBER(psi_f_std)        /* ... and its std, 0 too                                        */ \
    NUMBER(resistance_std)   /* std of the resistance [Ohm]                                   */ \
    NUMBER(inverter_voltage) /* dead time and device drops of a phase [V]                     */ \
    NUMBER(inverter_std)     /* std of that [V]                                               */ \
    NUMBER(inverter_current) /* the sign of a phase current i is tanh(i / this), nearly [A]   */ \
    NUMBER(slow_memory)      /* time in which magnet flux, resistance and inverter may change */ \
                             /* by one std [s]                                                */

typedef struct {
    FO_ADAPTIVE_CONFIG_FIELDS(FO_NUMBER_FIELD)
    fo_projection projection;
} fo_adaptive_config;

/* The fields after the plain observer; treat them as opaque. Per-unit unless stated. */
#define FO_ADAPTIVE_FIELDS(ARRAY, NUMBER)                                                          \
    NUMBER(saliency, "L_d - L_q, per ampere")                                                      \
    ARRAY(mean, FO_NP, "prior mean of flux, drift, magnet flux, resistance error [ohm], inverter " \
                       "[V]")                                                                      \
    ARRAY(variance, FO_NP, "prior variance of these")                                              \
    ARRAY(walk, FO_NP, "variance gained in a round of turns")                                      \
    NUMBER(noise, "variance of the residual")                                                      \
    NUMBER(through_R, "current noise in the flux, in a round")                                     \
    NUMBER(decoy, "current noise in a sample's flux, per ohm")                                     \
    NUMBER(charge, "24 times a mean current to its integral")                                      \
    NUMBER(over_current, "1 / current at which the inverter's sign is smoothed [1/A]")             \
    NUMBER(knee, "variance per V^2 while the inverter's sign is not sure")

typedef struct {
    fo_observer plain;
    FO_ADAPTIVE_FIELDS(FO_ARRAY_PARAMETER, FO_NUMBER_PARAMETER)
    fo_projection projection;
} fo_adaptive;

/* A position followed at the start. */
typedef struct {
    fo_real p[FO_NM];        /* flux, drift, square of the magnet flux */
    fo_real cost, least;     /* misfit to the information, of it and of its end */
    fo_real variance;        /* of its angle [rad^2]                   */
    fo_real theta;           /* angle at its last turn [rad]           */
    uint32_t age;            /* turns since it was sown                */
} fo_candidate;

/* Everything that changes. Plain data: copy it, store it, restore it. */
typedef struct {
    fo_state plain;
    bool running;                        /* the filter; else candidates are followed      */
    bool agreed;                         /* the filter, with its guard, since its start   */
    uint32_t turn;
    uint32_t restarts;                   /* of the filter, by its guard                   */
    fo_candidate candidates[FO_CANDIDATES];
    uint32_t searched;                   /* candidates that ended at the best one         */
    int32_t best;                        /* index of that one                             */
    fo_real disturbance;                 /* share of the EMF that may be wrong            */
    fo_real U[FO_NP_TRIANGLE], D[FO_NP]; /* covariance U D U', U unit upper triangular    */
    fo_real p[FO_NP];                    /* flux, drift, magnet flux, R error, inverter   */
    fo_real innovation, power, lag_one;  /* last one; fading sums over the innovations    */
    fo_real level;                       /* their power over the assumed                  */
    fo_real alpha;                       /* variance of the last innovation               */
    fo_real decoy[FO_NM];                /* column of a parameter that is only noise      */
    fo_real decoy_told, told;            /* last information on it and on the resistance  */
    fo_real pretends, tells;             /* that over the innovation's variance, averaged */
    uint32_t random;
    fo_real x[FO_N], theta;              /* direction of the position vector              */
    fo_real settled, swept;              /* time and turn since the start [memories, rad] */
    fo_real exposed;                     /* turn by an unmodelled voltage error [rad]     */
    fo_real turning, standing;           /* of the current [rad/sample]; time of it at standstill */
    fo_real charge[FO_N];                /* over the last interval                        */
    fo_real tilt;                        /* of the residual's derivative, by saliency     */
    fo_real disagree;                    /* with the guard, how long [memories]           */
    fo_tracker tracker;
} fo_adaptive_state;

typedef struct {
    fo_estimate position;     /* as of the plain observer                                     */
    fo_real drift_std;        /* of a component [V]                                           */
    fo_real psi_f, psi_f_std; /* magnet flux; active flux while nothing better is known [Wb]  */
    fo_real resistance_error; /* true minus assumed [Ohm]                                     */
    fo_real resistance_std;
    fo_real inverter_voltage; /* [V]                                                          */
    fo_real inverter_std;
    fo_real theta_other;      /* while two angles are in question, the other one [rad] ...    */
    fo_real weight_other;     /* ... and its weight, 0 to 1/2                                 */
    bool adapting;            /* the filter runs                                              */
} fo_adaptive_estimate;

/* Like fo_init, fo_reset, fo_step and fo_step_volt_seconds. */
fo_error fo_adaptive_init(fo_adaptive *observer, const fo_config *config,
                          const fo_adaptive_config *adaptive);
void fo_adaptive_reset(const fo_adaptive *observer, fo_adaptive_state *state);
void fo_adaptive_step(const fo_adaptive *observer, fo_adaptive_state *state,
                      const fo_real voltage[FO_N], const fo_real current[FO_N],
                      fo_adaptive_estimate *estimate);
void fo_adaptive_step_volt_seconds(const fo_adaptive *observer, fo_adaptive_state *state,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *estimate);

#ifdef __cplusplus
}
#endif

#endif
