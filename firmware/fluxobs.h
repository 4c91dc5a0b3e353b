/* fluxobs estimates flux, position, speed and drift of an electrical machine from biased currents
 * and voltages.
 *
 * This deployable observer uses the exact linear immersion of the machine's quadratic constraint.
 * It solves the immersion by square-root information least squares (in root-free form) with
 * exponential forgetting (docs/theory.md, sections 4 and 5).
 *
 * There are no allocations and no globals: the caller owns configuration, observer and state. Units
 * are SI in the interface and per-unit inside, so that single precision suffices.
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

/* Fields of fo_config: the machine and the measurement. The struct, its checks and the library's
 * binding are made from this list. Matrices are row-major. POSITIVE(name, least, most) states
 * the range outside which single precision fails: a divisor must not vanish.
 * Constraint: 0 = flux'Q1 flux + flux'Q2 i + i'Q3 i + E'flux + C'i + d. The observer never needs
 * d. */
#define FO_CONFIG_FIELDS(MATRIX, VECTOR, NUMBER, POSITIVE)                                       \
    MATRIX(Q1)                               /* only its symmetric part is used               */ \
    MATRIX(Q2)                               /* [Q1 unit * H]                                 */ \
    MATRIX(Q3)                               /* [Q1 unit * H^2]                               */ \
    VECTOR(E)                                /* [Q1 unit * Wb]                                */ \
    VECTOR(C)                                /* [Q1 unit * Wb H]                              */ \
    MATRIX(R)                                /* resistance [Ohm]                              */ \
    MATRIX(B)                                /* input matrix: d flux/dt = -R i + B u          */ \
    NUMBER(L_position)                       /* inductance in x = flux - L_position i [H]     */ \
    POSITIVE(sample_time, 1e-12, 1e12)       /* [s]                                           */ \
    POSITIVE(memory, 1e-37, 1e37)            /* memory of the exponential forgetting [s]      */ \
    POSITIVE(flux_base, 1e-12, 1e12)         /* flux base and prior std of the flux [Wb]      */ \
    POSITIVE(constraint_base, 1e-24, 1e24)   /* constraint base, |Q1| flux_base^2 [Wb^2]      */ \
    POSITIVE(constraint_noise, 1e-30, 1e30)  /* constraint noise std, |dw/di| current_noise   */ \
    POSITIVE(current_noise, 1e-12, 1e12)     /* noise std of a current component [A]          */ \
    POSITIVE(current_limit, 1e-37, 1e37)     /* a larger |i| is rejected as absurd [A]        */ \
    POSITIVE(drift_prior, 1e-37, 1e37)       /* prior std of the drift [V]                    */ \
    NUMBER(kink_now)                         /* held voltage: weight of its last step; or 0 */ \
    NUMBER(kink_before)                      /* held voltage: weight of the step before   */ \
    NUMBER(length_min)                       /* least |flux - L_position i| with a position   */ \
    POSITIVE(tracker_bandwidth, 1e-37, 1e37) /* bandwidth of angle and speed tracker [rad/s] */

#define FO_MATRIX_FIELD(name) fo_real name[FO_N][FO_N];
#define FO_VECTOR_FIELD(name) fo_real name[FO_N];
#define FO_NUMBER_FIELD(name) fo_real name;
#define FO_POSITIVE_FIELD(name, least, most) fo_real name;
typedef struct {
    FO_CONFIG_FIELDS(FO_MATRIX_FIELD, FO_VECTOR_FIELD, FO_NUMBER_FIELD, FO_POSITIVE_FIELD)
} fo_config;

/* fo_init converts the configuration to these fields, which a step needs; treat them as opaque.
 * They are per-unit unless stated. A machine's exported header repeats each meaning beside its
 * number. */
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
    const fo_map *map;  /* null if the inductances are constant */
#endif
} fo_observer;

/* An interval without a row: its volt-seconds [flux bases] are added to those of the next
 * interval. */
typedef struct {
    fo_real volt_seconds[FO_N];
    bool pending;
} fo_merged;

/* Square-root-free information factor: U x = z with weights d. U is unit upper triangular; x = (s,
 * flux, kappa, drift, c) is per-unit. The information matrix is U' diag(d) U. */
typedef struct {
    fo_real U[FO_TRIANGLE];
    fo_real d[FO_NX];
    fo_real z[FO_NX];
    fo_real noise[3];              /* information that is only noise: flux, flux-drift, drift */
} fo_information;

/* Tracks the angle of the flux. */
typedef struct {
    fo_real angle, speed, acceleration;  /* [rad, rad/s, rad/s^2] */
    fo_real settled;                     /* time with a small angle error [memories]      */
    bool lost;                           /* the next angle determines the speed         */
} fo_tracker;

/* The flux map linearised at the present current and an assumed rotor angle. Vectors are in alpha,
 * beta. */
typedef struct {
    fo_real direction[FO_N];     /* assumed direction of the rotor                            */
    fo_real armature_flux[FO_N]; /* position vector = flux - armature_flux                    */
    fo_real centre[FO_N];        /* |flux - centre|^2 - square is constant                    */
    fo_real square;              /* constant square minus the map's squared magnet flux       */
    fo_real active_flux;         /* length of the position vector; for a cage, its growth     */
    fo_real by_flux[FO_N];       /* gradient of (length - active_flux) over the flux          */
    fo_real by_current[FO_N];    /* negative gradient of (length - active_flux) over current  */
    fo_real rotor_flux;          /* growth of a cage's flux so far                            */
    fo_real magnetizing_current; /* current that sustains a cage's flux [A]; 0: unknown       */
    bool outside;                /* the current is outside the map                            */
} fo_map_point;

/* State of an observer: everything that changes. The state is plain data that may be copied, stored
 * and restored. Fields are per-unit unless stated. */
typedef struct {
    bool have_current, have_voltage;     /* received at least once since the last restart        */
    bool trusted;                        /* the least squares determines the flux                */
    bool have_trusted_flux;              /* a trusted flux exists, and is integrated             */
    uint32_t round_index;                /* position in the round of prior re-injections         */
    uint32_t consecutive_bad;
    uint32_t bad_voltages, bad_currents, absurd, outliers, restarts; /* counted since fo_reset   */
    fo_information info;
    fo_real x[FO_NX];                    /* solution of info                                     */
    fo_real current[FO_HISTORY][FO_N];   /* newest first [A]                                     */
    fo_real source[FO_N];                /* last good volt-seconds                               */
    fo_real volt_seconds[FO_N];          /* of the last interval, without the resistive drop     */
    fo_real held_source[FO_N];           /* volt-seconds of a held voltage                       */
    fo_real source_step[FO_N];           /* last step of held_source                             */
    fo_real step, length;                /* last step and length of the position vector          */
    fo_real noise_ratio;                 /* variance of the current noise / assumed variance     */
    fo_real noise_ratio_without_ripple;  /* the same, without a ripple at half the sampling rate */
    fo_real noise_inflation;             /* the smaller of both, but at least 1                  */
    fo_real voltage_turn;                /* turn of the flux due to a voltage error as large as the
                                          * drift's prior std [flux base rad] */
    fo_real innovation;                  /* last innovation, normalised                          */
    fo_real power, lag_one;              /* fading means of the squared innovation and of the
                                          * product of two successive innovations */
    fo_real noise_share;                 /* share of noise in the flux information               */
    fo_real inflation, angle_variance;   /* inflation of the covariance; angle variance [rad^2]  */
    fo_real drift_prior;                 /* prior information on the drift; reduced if too large */
    fo_real theta, rotation;             /* least-squares angle; rotation with known angle [rad] */
    fo_real flux[FO_N], drift[FO_N];     /* last trusted values; the flux is then integrated     */
    fo_real variance, variance_growth;   /* of the integrated angle: variance when the integration
                                          * began [rad^2], growth per memory^2 */
    fo_real open_loop_time;              /* duration of the integration [memories]               */
    fo_real open_loop_length;            /* length of the position vector when integration began */
    fo_real open_loop_error;             /* largest squared relative change of that length       */
    fo_tracker tracker;
#if FO_MAPPED
    fo_map_point map_point;              /* map at this sample                                   */
    fo_map_point previous_point;         /* map at the last sample                               */
    bool has_external_angle;             /* linearise the map at external_angle                  */
    fo_real external_angle;              /* angle used instead of the tracker's prediction [rad] */
    uint32_t outside;                    /* trusted samples outside the map since fo_reset       */
#endif
} fo_state;

/* Estimate of a sample. `valid` means: the position is known now, and the tracker has settled on
 * it. */
#define FO_ESTIMATE_FIELDS(VECTOR, NUMBER)                                                        \
    VECTOR(flux)            /* [Wb]                                                            */ \
    NUMBER(psi_f)           /* |flux - L_position i|: magnet or (if salient) active flux [Wb] */ \
    NUMBER(theta_e)         /* angle of the position vector, in (-pi, pi] [rad]                */ \
    NUMBER(theta_e_tracked) /* in (-pi, pi] [rad]                                              */ \
    NUMBER(speed_e)         /* electrical [rad/s]                                              */ \
    VECTOR(drift)           /* R current_bias - B voltage_bias [V]                             */ \
    NUMBER(theta_e_std)     /* std of theta_e [rad]; pi/sqrt(3) if nothing is known            */ \
    NUMBER(innovation)      /* innovation of this sample / assumed noise                       */ \
    NUMBER(noise_share)     /* share of noise in the flux information; 1: no position */

/* Why a position is not valid: the first reason that applies. Name and word. */
#define FO_REASONS(X)                                                                            \
    X(FO_VALID, "valid")              /* the position is valid                                */ \
    X(FO_NO_DATA, "no data")          /* no current or no voltage since the last restart      */ \
    X(FO_SEARCHING, "searching")      /* the angle is not known yet                           */ \
    X(FO_SETTLING, "settling")        /* the tracker has not settled on the angle yet         */ \
    X(FO_SLOW, "slow")                /* voltage errors may be as large as the EMF            */ \
    X(FO_UNCERTAIN, "uncertain")      /* the std of the angle is too large                    */ \
    X(FO_CONTRADICTED, "contradicted") /* the innovations contradict the model                */ \
    X(FO_UNCONFIRMED, "unconfirmed")  /* certain, but for less than half a turn yet           */ \
    X(FO_OUTSIDE_MAP, "outside map")  /* the current is outside the flux map                  */ \
    X(FO_BAD_SAMPLE, "bad sample")    /* this sample is missing, absurd or an outlier */

#define FO_REASON_NAME(name, word) name,
typedef enum { FO_REASONS(FO_REASON_NAME) FO_REASON_COUNT } fo_reason;

typedef struct {
    FO_ESTIMATE_FIELDS(FO_VECTOR_FIELD, FO_NUMBER_FIELD)
    bool valid;
    fo_reason valid_reason; /* FO_VALID if `valid` */
} fo_estimate;

typedef enum {
    FO_OK = 0,
    FO_ERROR_SAMPLE_TIME,      /* wrong sample time, or memory not ten to a million samples */
    FO_ERROR_BASE,             /* a base, noise, prior or limit is not positive             */
    FO_ERROR_NOT_FINITE,       /* a parameter is NaN or infinite                            */
    FO_ERROR_RANGE,            /* sizes contradict each other: a unit is probably wrong       */
    FO_ERROR_BUSY,             /* the interrupt has not yet taken the last configuration      */
    FO_ERROR_OTHER,            /* the data belong to another machine, precision or kind of observer,
                                * or need a feature that fluxobs_real.h leaves out */
    FO_ERROR_DAMAGED           /* the packed bytes have a wrong length, version or checksum   */
} fo_error;

/* Checks the configuration and prepares the observer. Use the observer only after FO_OK. */
fo_error fo_init(fo_observer *observer, const fo_config *config);

/* Returns the name of the first field for which fo_init refuses the configuration, or null. Where
 * sizes contradict each other, the named field is the one whose unit is most likely wrong. */
const char *fo_wrong(const fo_config *config);

#if FO_MAPPED
/* Gives the observer a flux map after fo_init. The map must live as long as the observer. The
 * constraint needs Q1 = 1; its Q2, Q3 and L_position must be those of a linear machine near the
 * map, because they scale the noise. */
fo_error fo_use_map(fo_observer *observer, const fo_map *map);
#endif

/* Resets the state: nothing is known, and all counters are 0. A step also resets a state of zeros,
 * and counts this reset as a restart. */
void fo_reset(const fo_observer *observer, fo_state *state);

/* Processes one sample: `current` is measured now [A], `voltage` is the mean over the interval that
 * ends now [V]. */
void fo_step(const fo_observer *observer, fo_state *state, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *estimate);

/* Like fo_step, with the exact volt-seconds of the interval: the integral of -R i + B u [Wb]. */
void fo_step_volt_seconds(const fo_observer *observer, fo_state *state,
                          const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                          fo_estimate *estimate);

/* Sums since the last step, for an observer that steps only every few interrupts. Start with zeros.
 * After each step, set the volt-seconds to zero. */
typedef struct {
    fo_real volt_seconds[FO_N]; /* [Wb], for fo_step_volt_seconds */
    fo_real current[FO_N];      /* current at the previous interrupt [A] */
} fo_gathered;

/* Adds the interval that ends now: `voltage` is its mean [V], `current` is measured now [A]. The
 * interval lasts `share` times the observer's sample time. */
void fo_gather(const fo_observer *observer, fo_gathered *gathered, fo_real share,
               const fo_real voltage[FO_N], const fo_real current[FO_N]);

/* Like fo_step, for interrupts at uneven times: the interval that ends now lasts `duration` [s]. A
 * duration below a tenth or above ten times the sample time is absurd and restarts the observer:
 * gather several short intervals. The mean current is computed from the interval's two ends only:
 * use fo_step where the period is constant. */
void fo_step_for(const fo_observer *observer, fo_state *state, fo_real duration,
                 const fo_real voltage[FO_N], const fo_real current[FO_N], fo_estimate *estimate);

#ifdef __cplusplus
}
#endif

#endif
