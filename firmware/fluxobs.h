/* fluxobs: flux, position, speed and drift of an electrical machine from biased
 * currents and voltages.
 *
 * The deployable observer: the exact linear immersion of the machine's quadratic
 * constraint, solved by square-root information least squares (in its root-free form) with
 * exponential forgetting (docs/theory.md, sections 4 and 5).
 *
 * No allocation, no globals; the caller owns configuration, observer and state.
 * SI units outside; per-unit inside, so that single precision suffices.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_H
#define FLUXOBS_H

#include "fluxobs_real.h"

#if FO_MAPPED
#include "fluxobs_map.h"
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum {
    FO_N = 2,                                /* flux components (alpha, beta)            */
    FO_NX = 2 * FO_N + 3,                    /* immersion: s, flux, kappa, drift, c      */
    FO_TRIANGLE = FO_NX * (FO_NX - 1) / 2,   /* packed strict upper triangle, row by row */
    FO_HISTORY = 4,                          /* current samples of the cubic quadrature  */
    FO_MAX_CONSECUTIVE_BAD = 3               /* bad samples bridged before a restart     */
};

/* The machine and the measurement. The struct, its checks and the library's binding are made from
 * this list. Matrices are row-major; POSITIVE(name, least, most) gives the range outside which
 * single precision fails: a divisor must not vanish.
 * Constraint: 0 = flux'Q1 flux + flux'Q2 i + i'Q3 i + E'flux + C'i + d; d is never needed. */
#define FO_CONFIG_FIELDS(MATRIX, VECTOR, NUMBER, POSITIVE)                                       \
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
    POSITIVE(constraint_base, 1e-24, 1e24)   /* base of constraint, |Q1| flux_base^2 [Wb^2]   */ \
    POSITIVE(constraint_noise, 1e-30, 1e30)  /* std of its noise, |dw/di| current_noise       */ \
    POSITIVE(current_noise, 1e-12, 1e12)     /* std of one current component [A]              */ \
    POSITIVE(current_limit, 1e-37, 1e37)     /* |i| above this is garbage [A]                 */ \
    POSITIVE(drift_prior, 1e-37, 1e37)       /* prior std of the drift [V]                    */ \
    NUMBER(kink_now)                         /* voltages are held over a sample: share of  */ \
    NUMBER(kink_before)                      /* their last two steps in what is missed; 0 */ \
    NUMBER(length_min)                       /* |flux - L_position i| below this: no position */ \
    POSITIVE(tracker_bandwidth, 1e-37, 1e37) /* of the angle and speed tracker [rad/s]        */

#define FO_MATRIX_FIELD(name) fo_real name[FO_N][FO_N];
#define FO_VECTOR_FIELD(name) fo_real name[FO_N];
#define FO_NUMBER_FIELD(name) fo_real name;
#define FO_POSITIVE_FIELD(name, least, most) fo_real name;
typedef struct {
    FO_CONFIG_FIELDS(FO_MATRIX_FIELD, FO_VECTOR_FIELD, FO_NUMBER_FIELD, FO_POSITIVE_FIELD)
} fo_config;

/* The configuration in the form that a step needs, made by fo_init; treat it as opaque. Per-unit
 * unless stated. The exported header of a machine repeats each meaning beside its number. */
#define FO_OBSERVER_FIELDS(MATRIX, ARRAY, NUMBER)                           \
    MATRIX(Q1x2, "2 Q1")                                                    \
    ARRAY(E, FO_N, "linear term of the constraint")                         \
    MATRIX(row_Q2, "output row from the current, over noise [1/A]")         \
    MATRIX(row_Q3, "[1/A^2]")                                               \
    ARRAY(row_C, FO_N, "[1/A]")                                             \
    NUMBER(row_s, "1 / noise")                                              \
    MATRIX(hR, "24ths of current to volt-seconds")                          \
    MATRIX(hB, "voltage to volt-seconds")                                   \
    NUMBER(kink_now, "what a step of the voltage takes from its volt-seconds") \
    NUMBER(kink_before, "what the step before it takes")                    \
    NUMBER(h, "sample time / memory")                                       \
    NUMBER(rho, "forgetting factor of a sample")                            \
    NUMBER(reinject, "share of the prior re-injected per turn")             \
    NUMBER(drift_prior_std, "prior std of the drift")                       \
    NUMBER(noise_information, "information from current noise, per sample") \
    NUMBER(flux_base, "[Wb]")                                               \
    NUMBER(drift_base, "[V]")                                               \
    NUMBER(current_limit, "[A]")                                            \
    NUMBER(over_noise, "1 / power of noise in third differences [1/A^2]")   \
    NUMBER(square_min, "smallest square of a usable position vector")       \
    NUMBER(L_position, "of the position vector, per ampere")                \
    NUMBER(position_noise, "variance of x from current noise")              \
    NUMBER(sample_time, "[s]")                                              \
    ARRAY(track, 3, "gains of the tracker")

#define FO_MATRIX_PARAMETER(name, meaning) fo_real name[FO_N][FO_N];
#define FO_ARRAY_PARAMETER(name, size, meaning) fo_real name[size];
#define FO_NUMBER_PARAMETER(name, meaning) fo_real name;
typedef struct {
    FO_OBSERVER_FIELDS(FO_MATRIX_PARAMETER, FO_ARRAY_PARAMETER, FO_NUMBER_PARAMETER)
#if FO_MAPPED
    const fo_map *map;  /* null: the constraint alone, with constant inductances */
#endif
} fo_observer;

/* Square-root-free information factor: U x = z with weights d, U unit upper triangular, x = (s,
 * flux, kappa, drift, c) per-unit. The information matrix is U' diag(d) U. */
typedef struct {
    fo_real U[FO_TRIANGLE];
    fo_real d[FO_NX];
    fo_real z[FO_NX];
    fo_real noise[3];              /* information from noise alone: flux, flux-drift, drift   */
} fo_information;

/* Tracks the angle of the flux. */
typedef struct {
    fo_real angle, speed, acceleration;  /* [rad, rad/s, rad/s^2]                      */
    fo_real settled;                     /* time for which its error was small [memories] */
    bool lost;                           /* it takes its speed from the next angle      */
} fo_tracker;

/* The flux map, linearised at the present current and at an assumed rotor angle; in alpha, beta. */
typedef struct {
    fo_real direction[FO_N];     /* assumed direction of the rotor                            */
    fo_real armature_flux[FO_N]; /* position vector = flux - armature_flux                    */
    fo_real centre[FO_N];        /* |flux - centre|^2 - square is constant                    */
    fo_real square;              /* less that of the map's magnet flux                        */
    fo_real active_flux;         /* length of the position vector; of a cage, its growth      */
    fo_real by_flux[FO_N];       /* gradient of that length less active_flux: by the flux ... */
    fo_real by_current[FO_N];    /* ... and, negative, by the current                         */
    fo_real rotor_flux;          /* growth of a cage's flux so far                            */
    fo_real magnetizing_current; /* that would sustain a cage's flux [A]; 0: unknown          */
    bool outside;                /* the current is outside the map                            */
} fo_map_point;

/* Everything that changes. Plain data: copy it, store it, restore it. Per-unit unless stated. */
typedef struct {
    bool have_current, have_voltage;     /* received since the last restart                      */
    bool trusted;                        /* the least squares determines the flux                */
    bool have_trusted_flux;              /* it once did: that flux is integrated since           */
    uint32_t round_index;                /* in the round of prior re-injections                  */
    uint32_t consecutive_bad;
    uint32_t bad_voltages, bad_currents, absurd, outliers, restarts; /* counted since fo_reset   */
    fo_information info;
    fo_real x[FO_NX];                    /* solution of info                                     */
    fo_real current[FO_HISTORY][FO_N];   /* newest first [A]                                     */
    fo_real source[FO_N];                /* last good volt-seconds                               */
    fo_real held_source[FO_N];           /* volt-seconds of a held voltage, ...                  */
    fo_real source_step[FO_N];           /* ... and their last step                              */
    fo_real step, length;                /* of the position vector: last step; its length        */
    fo_real noise_ratio;                 /* variance of the current noise over the assumed one   */
    fo_real noise_inflation;             /* the same, at least 1                                 */
    fo_real voltage_turn;                /* turn by a voltage error of the drift's prior std     */
                                         /* [flux base rad]                                      */
    fo_real innovation;                  /* last, normalised                                     */
    fo_real power, lag_one;              /* fading means of its square and its lag-one product   */
    fo_real noise_share;                 /* share of the flux information that is noise          */
    fo_real inflation, angle_variance;   /* of the covariance; of the angle [rad^2]              */
    fo_real drift_prior;                 /* information; reduced if it proved too tight          */
    fo_real theta, rotation;             /* of the least squares; rotation since known [rad]     */
    fo_real flux[FO_N], drift[FO_N];     /* last trusted; the flux is integrated from there      */
    fo_real variance, variance_growth;   /* of the integrated angle: at its start [rad^2]; per   */
                                         /* memory^2                                             */
    fo_real open_loop_time;              /* of that integration [memories]                       */
    fo_real open_loop_length;            /* of the position vector at its start                  */
    fo_real open_loop_error;             /* largest square of the relative change of that length */
    fo_tracker tracker;
#if FO_MAPPED
    fo_map_point map_point;              /* of this sample ...                                   */
    fo_map_point previous_point;         /* ... and of the last                                  */
    bool has_external_angle;             /* the map is linearised at this angle [rad], ...       */
    fo_real external_angle;              /* ... not at the one that the tracker predicts         */
    uint32_t outside;                    /* trusted samples outside the map, since fo_reset      */
#endif
} fo_state;

/* The estimate of a sample, and whether it is valid: the position is known now, and the tracker has
 * settled on it. */
#define FO_ESTIMATE_FIELDS(VECTOR, NUMBER)                                                        \
    VECTOR(flux)            /* [Wb]                                                            */ \
    NUMBER(psi_f)           /* |flux - L_position i|: magnet flux, active flux if salient [Wb] */ \
    NUMBER(theta_e)         /* directly from the flux, in (-pi, pi] [rad]                      */ \
    NUMBER(theta_e_tracked) /* in (-pi, pi] [rad]                                              */ \
    NUMBER(speed_e)         /* electrical [rad/s]                                              */ \
    VECTOR(drift)           /* R current_bias - B voltage_bias [V]                             */ \
    NUMBER(theta_e_std)     /* of theta_e [rad]; pi/sqrt(3) when nothing is known              */ \
    NUMBER(innovation)      /* of this sample, over the assumed noise                          */ \
    NUMBER(noise_share)     /* share of flux information that is noise; 1: no position         */

typedef struct {
    FO_ESTIMATE_FIELDS(FO_VECTOR_FIELD, FO_NUMBER_FIELD)
    bool valid;
} fo_estimate;

typedef enum {
    FO_OK = 0,
    FO_ERROR_SAMPLE_TIME,      /* sample time; memory below ten or above a million samples  */
    FO_ERROR_BASE,             /* a base, noise, prior or limit not positive                */
    FO_ERROR_NOT_FINITE,       /* a parameter is NaN or infinite                            */
    FO_ERROR_RANGE,            /* sizes that do not fit each other: a wrong unit, most likely */
    FO_ERROR_BUSY,             /* the interrupt has not yet taken the last configuration      */
    FO_ERROR_OTHER,            /* of another machine, precision or kind of observer, or not for */
                               /* these sources: fluxobs_real.h leaves something out        */
    FO_ERROR_DAMAGED           /* not what was packed: length, version or checksum is wrong   */
} fo_error;

/* Checks the configuration and prepares the observer, which may be used only after FO_OK. */
fo_error fo_init(fo_observer *observer, const fo_config *config);

/* Name of the first field for which fo_init refuses a configuration, null if it does not. Where
 * sizes do not fit each other, that is the field in which a wrong unit is likeliest. */
const char *fo_wrong(const fo_config *config);

#if FO_MAPPED
/* Gives the observer, after fo_init, a flux map, which has to live as long as the observer. The
 * constraint's Q1 has to be 1, and Q2, Q3 and L_position those of a linear machine near the map:
 * they scale the noise. */
fo_error fo_use_map(fo_observer *observer, const fo_map *map);
#endif

/* Resets the state: nothing is known, all counters are 0. A step resets a state of zeros by itself,
 * and counts that as a restart. */
void fo_reset(const fo_observer *observer, fo_state *state);

/* Processes one sample: the current now [A], the mean voltage over the interval ending now [V]. */
void fo_step(const fo_observer *observer, fo_state *state, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *estimate);

/* The same, with the exact volt-seconds of the interval: the integral of -R i + B u [Wb]. */
void fo_step_volt_seconds(const fo_observer *observer, fo_state *state,
                          const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                          fo_estimate *estimate);

/* For an observer that steps only every few interrupts: what has been gathered since its last step.
 * Start from zeros; after a step, set the volt-seconds to zero again. */
typedef struct {
    fo_real volt_seconds[FO_N]; /* [Wb], for fo_step_volt_seconds */
    fo_real current[FO_N];      /* at the previous interrupt [A]  */
} fo_gathered;

/* Adds the interval ending now: its mean voltage [V], the current now [A]. The interval lasts this
 * `share` of the observer's sample time. */
void fo_gather(const fo_observer *observer, fo_gathered *gathered, fo_real share,
               const fo_real voltage[FO_N], const fo_real current[FO_N]);

/* fo_step where interrupts come at uneven times: the interval that ends now has this duration [s].
 * One below a tenth or above ten of the sample time is absurd, and restarts the observer: gather
 * several short ones. The current's mean is that of its ends: use fo_step where the period is
 * constant. */
void fo_step_for(const fo_observer *observer, fo_state *state, fo_real duration,
                 const fo_real voltage[FO_N], const fo_real current[FO_N], fo_estimate *estimate);

#ifdef __cplusplus
}
#endif

/* An export of the plain observer alone has no adaptive one. */
#if FO_ADAPTIVE
#include "fluxobs_adaptive.h"
#endif

#endif
