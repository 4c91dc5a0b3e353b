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

/* What is known of the machine and of the measurement. The list makes the struct, its checks and the
 * library's binding. Matrices are row-major; POSITIVE(name, least, most) gives the range beyond which
 * single precision fails: what is divided by must not vanish.
 * Constraint: 0 = flux'Q1 flux + flux'Q2 i + i'Q3 i + E'flux + C'i + d; d is never needed. */
#define FO_CONFIG_FIELDS(MATRIX, VECTOR, NUMBER, POSITIVE)                                        \
    MATRIX(Q1)                               /* only the symmetric part enters                */ \
    MATRIX(Q2)                               /* [Q1 unit * H]                                 */ \
    MATRIX(Q3)                               /* [Q1 unit * H^2]                               */ \
    VECTOR(E)                                /* [Q1 unit * Wb]                                */ \
    VECTOR(C)                                /* [Q1 unit * Wb H]                              */ \
    MATRIX(R)                                /* resistance [Ohm]                              */ \
    MATRIX(B)                                /* input matrix: d flux/dt = -R i + B u          */ \
    NUMBER(L_position)                       /* position vector x = flux - L_position i [H]   */ \
    POSITIVE(sample_time, 1e-12, 1e12)       /* [s]                                           */ \
    POSITIVE(memory, 1e-37, 1e37)            /* exponential memory of the least squares [s]   */ \
    POSITIVE(flux_base, 1e-12, 1e12)         /* base of flux, also the prior's std [Wb]       */ \
    POSITIVE(constraint_base, 1e-24, 1e24)   /* of the constraint, |Q1| flux_base^2 [Wb^2]    */ \
    POSITIVE(constraint_noise, 1e-30, 1e30)  /* std of its noise, |dw/di| current_noise       */ \
    POSITIVE(current_noise, 1e-12, 1e12)     /* std of one current component [A]              */ \
    POSITIVE(current_limit, 1e-37, 1e37)     /* |i| above this is no measurement [A]          */ \
    POSITIVE(drift_prior, 1e-37, 1e37)       /* std of the drift before anything is known [V] */ \
    NUMBER(length_min)                       /* |flux - L_position i| below this: no position */ \
    POSITIVE(tracker_bandwidth, 1e-37, 1e37) /* of the angle and speed tracker [rad/s]        */

#define FO_MATRIX_FIELD(name) fo_real name[FO_N][FO_N];
#define FO_VECTOR_FIELD(name) fo_real name[FO_N];
#define FO_NUMBER_FIELD(name) fo_real name;
#define FO_POSITIVE_FIELD(name, least, most) fo_real name;
typedef struct {
    FO_CONFIG_FIELDS(FO_MATRIX_FIELD, FO_VECTOR_FIELD, FO_NUMBER_FIELD, FO_POSITIVE_FIELD)
} fo_config;

/* The configuration in the form the step needs; treat as opaque. Made by fo_init. Per-unit unless
 * said. Name and meaning: the exported header of a machine repeats it beside each number. */
#define FO_OBSERVER_FIELDS(MATRIX, ARRAY, NUMBER)                            \
    MATRIX(Q1x2, "2 Q1")                                                     \
    ARRAY(E, FO_N, "linear term of the constraint")                          \
    MATRIX(row_Q2, "output row from the current, over noise [1/A]")          \
    MATRIX(row_Q3, "[1/A^2]")                                                \
    ARRAY(row_C, FO_N, "[1/A]")                                              \
    NUMBER(row_s, "1 / noise")                                               \
    MATRIX(hR, "24ths of current to volt-seconds")                           \
    MATRIX(hB, "voltage to volt-seconds")                                    \
    NUMBER(h, "sample time / memory")                                        \
    NUMBER(rho, "forgetting a sample")                                       \
    NUMBER(reinject, "share of the prior re-injected in a turn")             \
    NUMBER(plausible, "std of the drift before anything is known")           \
    NUMBER(noise_information, "what current noise alone pretends, a sample") \
    NUMBER(flux_base, "[Wb]")                                                \
    NUMBER(drift_base, "[V]")                                                \
    NUMBER(current_limit, "[A]")                                             \
    NUMBER(over_noise, "1 / what noise makes of third differences [1/A^2]")  \
    NUMBER(square_min, "of a position vector that tells")                    \
    NUMBER(L_position, "per ampere")                                         \
    NUMBER(position_noise, "variance of x from the current's noise")         \
    NUMBER(sample_time, "[s]")                                               \
    ARRAY(track, 3, "gains of the tracker")

#define FO_MATRIX_PARAMETER(name, meaning) fo_real name[FO_N][FO_N];
#define FO_ARRAY_PARAMETER(name, size, meaning) fo_real name[size];
#define FO_NUMBER_PARAMETER(name, meaning) fo_real name;
typedef struct {
    FO_OBSERVER_FIELDS(FO_MATRIX_PARAMETER, FO_ARRAY_PARAMETER, FO_NUMBER_PARAMETER)
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

/* What a sample returns; then whether it is valid: the position is known now, and the tracker has
 * settled on it. */
#define FO_ESTIMATE_FIELDS(VECTOR, NUMBER)                                                         \
    VECTOR(flux)            /* [Wb]                                                            */ \
    NUMBER(psi_f)           /* |flux - L_position i|: magnet flux, active flux if salient [Wb] */ \
    NUMBER(theta_e)         /* straight from the flux, in (-pi, pi] [rad]                      */ \
    NUMBER(theta_e_tracked) /* in (-pi, pi] [rad]                                              */ \
    NUMBER(speed_e)         /* electrical [rad/s]                                              */ \
    VECTOR(drift)           /* R current_bias - B voltage_bias [V]                             */ \
    NUMBER(theta_e_std)     /* of theta_e [rad]; pi/sqrt(3) when nothing is known              */ \
    NUMBER(innovation)      /* of this sample, over the assumed noise                          */ \
    NUMBER(noise_share)     /* of the flux information, only noise; 1: no position             */

typedef struct {
    FO_ESTIMATE_FIELDS(FO_VECTOR_FIELD, FO_NUMBER_FIELD)
    bool valid;
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
