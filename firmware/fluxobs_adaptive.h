/* fluxobs, the adaptive observer: starts within a fraction of a turn at an unknown angle; learns
 * magnet flux, resistance, the inverter's voltage loss, current offsets and an asymmetry of the
 * phases; models saliency; and says what is not known yet.
 *
 * The observer of fluxobs.h runs inside, on volt-seconds corrected by what has been learnt. It is
 * start and guard. Two time scales in one triangle: a fast filter on (flux, drift), and below it
 * the parameters, which see only what the fast filter leaves (docs/theory.md, section 13).
 *
 * For machines with Q1 = 1, E = 0: |flux - L i| = psi_f + saliency i_d.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_ADAPTIVE_H
#define FLUXOBS_ADAPTIVE_H

#include "fluxobs.h"
#include "fluxobs_triangle.h"

#ifdef __cplusplus
extern "C" {
#endif

#define fo_adaptive_config FO_NAME(fo_adaptive_config)
#define fo_adaptive FO_NAME(fo_adaptive)
#define fo_candidate FO_NAME(fo_candidate)
#define fo_block FO_NAME(fo_block)
#define fo_adaptive_state FO_NAME(fo_adaptive_state)
#define fo_adaptive_estimate FO_NAME(fo_adaptive_estimate)
#define fo_learnt FO_NAME(fo_learnt)
#define fo_adaptive_init FO_NAME(fo_adaptive_init)
#define fo_adaptive_wrong FO_NAME(fo_adaptive_wrong)
#if FO_ASYMMETRIC
#define fo_adaptive_reset FO_NAME(fo_adaptive_reset_asymmetric)
#define fo_adaptive_step FO_NAME(fo_adaptive_step_asymmetric)
#define fo_adaptive_step_volt_seconds FO_NAME(fo_adaptive_step_volt_seconds_asymmetric)
#define fo_adaptive_step_for FO_NAME(fo_adaptive_step_for_asymmetric)
#else
#define fo_adaptive_reset FO_NAME(fo_adaptive_reset)
#define fo_adaptive_step FO_NAME(fo_adaptive_step)
#define fo_adaptive_step_volt_seconds FO_NAME(fo_adaptive_step_volt_seconds)
#define fo_adaptive_step_for FO_NAME(fo_adaptive_step_for)
#endif
#define fo_adaptive_learnt FO_NAME(fo_adaptive_learnt)
#define fo_adaptive_restart FO_NAME(fo_adaptive_restart)

/* Order of the parameters. The inverter's loss is a sum of two: one grows within small currents,
 * one within larger ones. The last is never learnt: what the loss may differ from that sum. */
enum {
    FO_PSI,
    FO_RESISTANCE,
    FO_INVERTER,
    FO_OFFSET = FO_INVERTER + 2,
    FO_INDUCTANCE = FO_OFFSET + 2,
    FO_ASYMMETRY = FO_INDUCTANCE + 2,
#if FO_ASYMMETRIC
    FO_CURVE = FO_ASYMMETRY + 2,
#else
    FO_CURVE = FO_ASYMMETRY,
#endif
    FO_NP,                 /* how many                                             */
    FO_NF = 2 * FO_N,      /* the fast filter: flux, drift                         */
    FO_NA = FO_NF + FO_NP, /* order of the triangle: fast filter, then parameters  */
    FO_NM = 2 * FO_N + 1,  /* the manifold: flux, drift, square of the magnet flux */
    FO_CANDIDATES = 4      /* positions followed at the start                      */
};

/* When the information is projected on the manifold. */
typedef enum {
    FO_PROJECT_NEVER, /* the start waits for the plain observer's position */
    FO_PROJECT_START  /* until the position is known                       */
} fo_projection;

/* Assumed values of machine and inverter, and their standard deviations, 0 if known; then when the
 * information is projected. */
#define FO_ADAPTIVE_CONFIG_FIELDS(NUMBER)                                                        \
    NUMBER(saliency)         /* L_d - L_position [H]                                          */ \
    NUMBER(L_d_std)          /* std of the inductance along d, a share of it [1], ...         */ \
    NUMBER(L_q_std)          /* ... and of that along q                                       */ \
    NUMBER(lag_std)          /* std of the time by which a voltage comes late [s]             */ \
    NUMBER(psi_f)            /* magnet flux [Wb]; 0 without magnets, ...                      */ \
    NUMBER(psi_f_std)        /* ... and its std, 0 too                                        */ \
    NUMBER(resistance_std)   /* std of the resistance [Ohm]                                   */ \
    NUMBER(inverter_voltage) /* dead time and device drops of a phase [V]                     */ \
    NUMBER(inverter_std)     /* std of that [V]                                               */ \
    NUMBER(inverter_current) /* the sign of a phase current i is tanh(i / this), nearly [A]   */ \
    NUMBER(offset_std)       /* std of the offset of a current component [A]                  */ \
    NUMBER(asymmetry_std)    /* std of g, both components, in u' = u + g conj(u) [1]          */ \
    NUMBER(slow_memory)      /* time in which a parameter may change by one std [s]           */

typedef struct {
    FO_ADAPTIVE_CONFIG_FIELDS(FO_NUMBER_FIELD)
    fo_projection projection;
} fo_adaptive_config;

/* The fields after the plain observer; treat them as opaque. Per-unit unless stated. */
#define FO_ADAPTIVE_FIELDS(ARRAY, NUMBER)                                                        \
    NUMBER(saliency, "L_d - L_q, per ampere")                                                    \
    NUMBER(psi, "assumed magnet flux")                                                           \
    ARRAY(std, FO_NP, "prior std: 1, ohm, volt, volt, ampere, ampere, 1, 1, 1, 1, volt per "     \
                      "volt")                                                                    \
    NUMBER(inverter_mean, "assumed loss of each part of the inverter [V]")                       \
    NUMBER(volt, "one volt over a sample")                                                       \
    ARRAY(over_current, 2, "1 / currents at which the parts of the inverter's loss saturate "    \
                           "[1/A]")                                                              \
    NUMBER(over_rated, "1 / current at which the rest of the loss is zero again [1/A]")          \
    NUMBER(lag_std, "std of the lag [s]")                                                        \
    NUMBER(through_L, "variance of a residual from current noise")                               \
    NUMBER(unmodelled, "voltage error that is in no model")                                      \
    NUMBER(slow, "memory / slow memory")

typedef struct {
    fo_observer plain;
    FO_ADAPTIVE_FIELDS(FO_ARRAY_PARAMETER, FO_NUMBER_PARAMETER)
    fo_projection projection;
} fo_adaptive;

/* A candidate: one hypothesis of flux and drift at the start. */
typedef struct {
    fo_real p[FO_NM];        /* flux, drift, square of the magnet flux           */
    fo_real cost;            /* misfit to the information                        */
    fo_real predicted_cost;  /* the same after the next Gauss-Newton step        */
    fo_real variance;        /* of its angle [rad^2]                             */
    fo_real theta;           /* angle after its last step [rad]                  */
    uint32_t age;            /* steps since it was placed                        */
} fo_candidate;

/* Sums over the samples since the last measurement row of the filter. */
typedef struct {
    uint32_t samples;
    fo_real time;                     /* [memories]                                         */
    fo_real theta;                    /* angle at its start [rad]                           */
    fo_real sensitivity[FO_NP][FO_N]; /* of the flux to each parameter                      */
    fo_real unmodelled;               /* voltage error outside the model, integrated        */
    fo_real residual;                 /* |x| - saliency i_d - psi_f, summed                 */
    fo_real by_flux[FO_N];            /* its derivative by the flux, summed, ...            */
    fo_real by_flux_time[FO_N];       /* ... and times the time                             */
    fo_real by_parameter[FO_NP];      /* its derivative by each parameter, summed           */
} fo_block;

/* Everything that changes. Plain data: copy it, store it, restore it. */
typedef struct {
    fo_state plain;
    bool running;                        /* the filter; else candidates are fitted          */
    bool frozen;                         /* the parameters are not updated                  */
    bool seeded;                         /* the plain observer integrates from a seed       */
    uint32_t sample_index;
    uint32_t restarts;                   /* of the filter, by its guard                     */
    union {                              /* before the filter runs, and while it does       */
        struct {
            fo_candidate candidates[FO_CANDIDATES];
            uint32_t confirmations;      /* candidates that converged to the best one       */
            int32_t best;                /* index of the best one                           */
        } start;
        fo_block block;
    } now;
    /* Information factor. Flux and drift: about their estimates. Parameters: about their prior
     * mean, in their prior stds. */
    fo_real U[FO_PACKED(FO_NA)], d[FO_NA], z[FO_NA];
    fo_real flux[FO_N], drift[FO_N], p[FO_NP]; /* the estimates                             */
    uint32_t reinject_index;             /* parameter whose prior is re-injected next       */
    uint32_t report_index;               /* std that is updated next                        */
    fo_real forgotten;                   /* share of information forgotten in this round ...*/
    fo_real forgotten_before;            /* ... and in the last                             */
    fo_real noise_level;                 /* power of the filter's innovations over the      */
                                         /* assumed one                                     */
    fo_real rows;                        /* measurement rows since the start                */
    fo_real innovation_power;            /* power of the parameters' innovations over their */
                                         /* variance                                        */
    fo_real operating_point[3];          /* i_d, i_q [A], electrical step per memory        */
    fo_real rows_at_point;               /* rows taken there                                */
    fo_real variance_across;             /* of the flux across x, L_q known, ...            */
    fo_real variance_time;               /* ... at this time since the last row [memories]  */
    fo_real variance_by_L_q;             /* what the error of L_q adds to it, ...           */
    fo_real armature_flux_q;             /* ... at this armature flux, ...                  */
    fo_real variance_by_L_q_now;         /* ... and at the present one                      */
    fo_real reported_std[3];             /* of psi_f, resistance, inverter's loss           */
    fo_real voltage_std;                 /* of the voltage, from the parameters, at ...     */
    fo_real voltage_std_square;          /* ... this square of the current [A^2]            */
    fo_real emf_ratio;                   /* that voltage over the EMF, accumulated [rad]    */
    fo_real voltage_turn;                /* turn by an unmodelled voltage error [rad]       */
    fo_real signs[2][FO_N];              /* of the phase currents, soft: inverter's loss    */
    fo_real sign_gradient[3];            /* its derivative by the current                   */
#if FO_MAPPED
    fo_map_point map_point;              /* the map at the filter's own angle               */
#endif
    fo_real knee;                        /* how soft the harder signs are now, 0 to 1       */
    fo_real x[FO_N], theta;              /* direction of the position vector                */
    fo_real rotation;                    /* before the filter runs: since one candidate is  */
                                         /* likely [rad]                                    */
    fo_real disagreement;                /* turn while it differs from the guard [rad]      */
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

/* What has been learnt: every parameter and its standard deviation. */
#define FO_LEARNT_FIELDS(VECTOR, NUMBER)                       \
    NUMBER(psi_f)            /* [Wb]                        */ \
    NUMBER(psi_f_std)                                          \
    NUMBER(resistance_error) /* true minus assumed [Ohm]    */ \
    NUMBER(resistance_std)                                     \
    NUMBER(inverter_voltage) /* [V]                         */ \
    NUMBER(inverter_std)                                       \
    VECTOR(offset)           /* of the measured current [A] */ \
    VECTOR(offset_std)                                         \
    VECTOR(asymmetry)        /* g in u' = u + g conj(u) [1] */ \
    VECTOR(asymmetry_std)                                      \
    VECTOR(inductance_error) /* of L_d and L_q, shares [1]  */ \
    VECTOR(inductance_std)

typedef struct {
    FO_LEARNT_FIELDS(FO_VECTOR_FIELD, FO_NUMBER_FIELD)
} fo_learnt;

/* Like fo_init, fo_wrong, fo_reset, fo_step, fo_step_volt_seconds and fo_step_for. */
fo_error fo_adaptive_init(fo_adaptive *observer, const fo_config *config,
                          const fo_adaptive_config *adaptive);
const char *fo_adaptive_wrong(const fo_config *config, const fo_adaptive_config *adaptive);
void fo_adaptive_reset(const fo_adaptive *observer, fo_adaptive_state *state);

/* Resets all but what has been learnt, as after a power cycle. If `frozen`, that stays as it is. */
void fo_adaptive_restart(const fo_adaptive *observer, fo_adaptive_state *state, bool frozen);

void fo_adaptive_step(const fo_adaptive *observer, fo_adaptive_state *state,
                      const fo_real voltage[FO_N], const fo_real current[FO_N],
                      fo_adaptive_estimate *estimate);
void fo_adaptive_step_volt_seconds(const fo_adaptive *observer, fo_adaptive_state *state,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *estimate);
void fo_adaptive_step_for(const fo_adaptive *observer, fo_adaptive_state *state, fo_real duration,
                          const fo_real voltage[FO_N], const fo_real current[FO_N],
                          fo_adaptive_estimate *estimate);
void fo_adaptive_learnt(const fo_adaptive *observer, const fo_adaptive_state *state,
                        fo_learnt *learnt);

#ifdef __cplusplus
}
#endif

#endif
