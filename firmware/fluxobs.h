/* fluxobs: flux, position, speed and drift of an electrical machine from biased
 * currents and voltages.
 *
 * The deployable observer: the exact linear immersion of the machine's quadratic
 * constraint, solved by a square-root information least squares (in its root-free form) with
 * exponential forgetting (docs/theory.md, sections 4 and 5).
 *
 * No allocation, no globals; the caller owns configuration, observer and state.
 * SI units outside; per-unit inside, so that single precision suffices.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_H
#define FLUXOBS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* FO_SINGLE, defined for all sources or for none, chooses single precision. The names of the
 * functions say which, so that a mixture does not link. */
#ifdef FO_SINGLE
typedef float fo_real;
#define fo_init fo_init_single
#define fo_reset fo_reset_single
#define fo_step fo_step_single
#define fo_step_volt_seconds fo_step_volt_seconds_single
#define fo_gather fo_gather_single
#else
typedef double fo_real;
#endif

enum {
    FO_N = 2,                                /* flux components (alpha, beta)            */
    FO_NX = 2 * FO_N + 3,                    /* immersion: s, flux, kappa, drift, c      */
    FO_TRIANGLE = FO_NX * (FO_NX - 1) / 2,   /* packed strict upper triangle, row by row */
    FO_HISTORY = 4,                          /* current samples of the cubic quadrature  */
    FO_MAX_CONSECUTIVE_BAD = 3               /* bad samples bridged before a restart     */
};

/* What is known of the machine and of the measurement. Matrices are row-major.
 * Constraint: 0 = flux'Q1 flux + flux'Q2 i + i'Q3 i + E'flux + C'i + d; d is never needed. */
typedef struct {
    fo_real Q1[FO_N][FO_N];        /* only the symmetric part enters                           */
    fo_real Q2[FO_N][FO_N];        /* [Q1 unit * H]                                            */
    fo_real Q3[FO_N][FO_N];        /* [Q1 unit * H^2]                                          */
    fo_real E[FO_N];               /* [Q1 unit * Wb]                                           */
    fo_real C[FO_N];               /* [Q1 unit * Wb H]                                         */
    fo_real R[FO_N][FO_N];         /* resistance [Ohm]                                         */
    fo_real B[FO_N][FO_N];         /* input matrix: d flux/dt = -R i + B u                     */
    fo_real L_position;            /* position vector x = flux - L_position i [H]              */
    fo_real sample_time;           /* [s]                                                      */
    fo_real memory;                /* exponential memory of the least squares [s]              */
    fo_real flux_base;             /* base of per-unit flux, also the prior's std [Wb]         */
    fo_real constraint_base;       /* base of the constraint, |Q1| flux_base^2 [Wb^2]          */
    fo_real constraint_noise;      /* std of the constraint's noise, |dw/di| current_noise     */
    fo_real current_noise;         /* std of one current component [A]                         */
    fo_real current_limit;         /* |i| above this is no measurement [A]                     */
    fo_real drift_prior;           /* std of the drift before anything is known [V]            */
    fo_real length_min;            /* |flux - L_position i| below this is no position [Wb]     */
    fo_real tracker_bandwidth;     /* of the angle and speed tracker [rad/s]                   */
} fo_config;

/* The configuration in the form the step needs; treat as opaque. Made by fo_init. */
typedef struct {
    fo_real Q1x2[FO_N][FO_N];      /* 2 Q1, per-unit                                  */
    fo_real E[FO_N];               /* per-unit                                        */
    fo_real row_Q2[FO_N][FO_N];    /* whitened output row from the current [1/A]      */
    fo_real row_Q3[FO_N][FO_N];    /* [1/A^2]                                         */
    fo_real row_C[FO_N];           /* [1/A]                                           */
    fo_real row_s;                 /* 1 / noise, per-unit                             */
    fo_real hR[FO_N][FO_N];        /* current times 24 to per-unit volt-seconds       */
    fo_real hB[FO_N][FO_N];        /* voltage to per-unit volt-seconds                */
    fo_real h;                     /* sample time / memory                            */
    fo_real rho;                   /* forgetting a sample                             */
    fo_real reinject;              /* share of the prior re-injected in a turn        */
    fo_real plausible;             /* std of the drift before anything is known, per-unit */
    fo_real noise_information;     /* per sample, what current noise alone pretends   */
    fo_real flux_base, drift_base; /* [Wb], [V]                                       */
    fo_real current_limit;         /* [A]                                             */
    fo_real over_noise;            /* 1 / what noise makes of third differences [1/A^2] */
    fo_real square_min;            /* of a position vector that tells, squared, per-unit */
    fo_real L_position;            /* per-unit per ampere                             */
    fo_real position_noise;        /* variance in x from the current's noise          */
    fo_real sample_time;           /* [s]                                             */
    fo_real track[3];              /* gains of the tracker                            */
} fo_observer;

/* U x = z with weights d, U unit upper triangular, x = (s, flux, kappa, drift, c) per-unit: the
 * square-root information R x = sqrt(d) z, R = sqrt(d) U, without its roots. */
typedef struct {
    fo_real U[FO_TRIANGLE];
    fo_real d[FO_NX];
    fo_real z[FO_NX];
    fo_real noise[3];              /* what noise alone pretends: (flux, flux-drift, drift) */
} fo_information;

/* Follows the angle of the flux. */
typedef struct {
    fo_real angle, speed, acceleration;  /* [rad, rad/s, rad/s^2]      */
    fo_real settled;                     /* near for so long [memories] */
    bool lost;                           /* the speed is taken from the next angle */
} fo_tracker;

/* Everything that changes. Plain data: copy it, store it, restore it. Per-unit unless said. */
typedef struct {
    bool have_current, have_voltage;     /* seen since the last restart                          */
    bool trusted, have_carried;          /* the least squares is now; was once                   */
    uint32_t turn;                       /* of re-injecting the prior and judging                */
    uint32_t consecutive_bad;
    uint32_t bad_voltages, bad_currents, absurd, outliers, restarts; /* counted since fo_reset   */
    fo_information info;
    fo_real x[FO_NX];                    /* its solution                                         */
    fo_real current[FO_HISTORY][FO_N];   /* newest first [A]                                     */
    fo_real source[FO_N];                /* last good volt-seconds                               */
    fo_real step, length;                /* of the position vector: last step, |flux - L i|      */
    fo_real rough, roughness;            /* variance of the current's noise over the assumed; >= 1 */
    fo_real exposed;                     /* turn by a plausible voltage error, flux base [rad]   */
    fo_real innovation;                  /* last, normalised                                     */
    fo_real power, lag_one;              /* sums over the innovations, forgetting                */
    fo_real noise_share, inflation, spread; /* as last judged; variance of the angle [rad^2]     */
    fo_real drift_prior;                 /* information; less where it has proved too tight      */
    fo_real theta, swept;                /* of the least squares; turned since it is known [rad] */
    fo_real flux[FO_N], drift[FO_N];     /* last trusted, carried on while nothing is known      */
    fo_real variance, growth;            /* of the carried position: start, and a memory squared [rad^2] */
    fo_real carried;                     /* for how long [memories]                              */
    fo_real carried_length, carried_off; /* of the position vector: at its start, largest change */
    fo_tracker tracker;
} fo_state;

typedef struct {
    fo_real flux[FO_N];        /* [Wb]                                                            */
    fo_real psi_f;             /* |flux - L_position i|: magnet flux, active flux if salient [Wb] */
    fo_real theta_e;           /* straight from the flux, in (-pi, pi] [rad]                      */
    fo_real theta_e_tracked;   /* in (-pi, pi] [rad]                                              */
    fo_real speed_e;           /* electrical [rad/s]                                              */
    fo_real drift[FO_N];       /* R current_bias - B voltage_bias [V]                             */
    fo_real theta_e_std;       /* of theta_e [rad]; pi/sqrt(3) when nothing is known              */
    fo_real innovation;        /* of this sample, normalised by the assumed noise                 */
    fo_real noise_share;       /* share of the flux information that is only noise; 1: no position */
    bool valid;                /* the position is known now, and the tracker has settled on it    */
} fo_estimate;

typedef enum {
    FO_OK = 0,
    FO_ERROR_SAMPLE_TIME,      /* sample time; memory below ten or above a million samples  */
    FO_ERROR_BASE,             /* a base, noise, prior or limit not positive                */
    FO_ERROR_NOT_FINITE,       /* a parameter is NaN or infinite                            */
    FO_ERROR_RANGE             /* sizes that do not fit each other: a wrong unit, most likely */
} fo_error;

/* Checks the configuration and prepares the observer, which serves only after FO_OK. */
fo_error fo_init(fo_observer *observer, const fo_config *config);

/* Nothing known, nothing counted. */
void fo_reset(const fo_observer *observer, fo_state *state);

/* One sample: the current now [A] and the mean voltage over the interval ending now [V]. */
void fo_step(const fo_observer *observer, fo_state *state, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *estimate);

/* The same with the interval's volt-seconds, the integral of -R i + B u [Wb], known exactly. */
void fo_step_volt_seconds(const fo_observer *observer, fo_state *state,
                          const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                          fo_estimate *estimate);

/* For an observer that is stepped every few interrupts: what has been gathered since its last step.
 * Start from zeros; after a step set the volt-seconds to zero again. */
typedef struct {
    fo_real volt_seconds[FO_N]; /* [Wb], for fo_step_volt_seconds */
    fo_real current[FO_N];      /* at the interrupt before [A]    */
} fo_gathered;

/* Adds the interval ending now: its mean voltage [V], the current now [A]. The interval is this
 * `share` of the observer's sample time. */
void fo_gather(const fo_observer *observer, fo_gathered *gathered, fo_real share,
               const fo_real voltage[FO_N], const fo_real current[FO_N]);

#ifdef __cplusplus
}
#endif

#endif
