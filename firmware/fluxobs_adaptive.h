/* fluxobs, the adaptive observer: starts within a fraction of a turn at an unknown angle. It learns
 * magnet flux, resistance, the inverter's voltage loss, current offsets and an asymmetry of the
 * phases. It models saliency, and reports what is still unknown.
 *
 * The observer of fluxobs.h runs inside, as start and guard; its volt-seconds are corrected by the
 * learnt parameters. One information factor has two time scales: a fast filter on (flux, drift),
 * and the parameters, which are updated by the part of a row that the fast filter does not explain
 * (docs/theory.md, section 13).
 *
 * Machines must have Q1 = 1 and E = 0: |flux - L i| = psi_f + saliency i_d.
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
#define fo_block FO_NAME(fo_block)
#define fo_sums FO_NAME(fo_sums)
#define fo_ripple FO_NAME(fo_ripple)
#define fo_candidate FO_NAME(fo_candidate)
#define fo_search FO_NAME(fo_search)
#define fo_block_end FO_NAME(fo_block_end)
#define fo_search_data FO_NAME(fo_search_data)
#define fo_learning_report FO_NAME(fo_learning_report)
#define fo_answer FO_NAME(fo_answer)
#define fo_mail FO_NAME(fo_mail)
#define fo_learner FO_NAME(fo_learner)
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
#define fo_adaptive_fast_step FO_NAME(fo_adaptive_fast_step_asymmetric)
#define fo_adaptive_fast_step_volt_seconds FO_NAME(fo_adaptive_fast_step_volt_seconds_asymmetric)
#define fo_adaptive_fast_step_for FO_NAME(fo_adaptive_fast_step_for_asymmetric)
#define fo_adaptive_learn FO_NAME(fo_adaptive_learn_asymmetric)
#else
#define fo_adaptive_reset FO_NAME(fo_adaptive_reset)
#define fo_adaptive_step FO_NAME(fo_adaptive_step)
#define fo_adaptive_step_volt_seconds FO_NAME(fo_adaptive_step_volt_seconds)
#define fo_adaptive_step_for FO_NAME(fo_adaptive_step_for)
#define fo_adaptive_fast_step FO_NAME(fo_adaptive_fast_step)
#define fo_adaptive_fast_step_volt_seconds FO_NAME(fo_adaptive_fast_step_volt_seconds)
#define fo_adaptive_fast_step_for FO_NAME(fo_adaptive_fast_step_for)
#define fo_adaptive_learn FO_NAME(fo_adaptive_learn)
#endif
#define fo_adaptive_learnt FO_NAME(fo_adaptive_learnt)
#define fo_adaptive_restart FO_NAME(fo_adaptive_restart)

/* Order of the parameters. The inverter's loss is the sum of two parameters: one grows within small
 * currents, the other within larger currents. The parameters from the resistance to the asymmetry
 * change the volt-seconds. */
enum {
    FO_PSI,
    FO_RESISTANCE,
    FO_INVERTER,
    FO_OFFSET = FO_INVERTER + 2,
    FO_ASYMMETRY = FO_OFFSET + 2,
#if FO_ASYMMETRIC
    FO_INDUCTANCE = FO_ASYMMETRY + 2,
#else
    FO_INDUCTANCE = FO_ASYMMETRY,
#endif
    FO_NP = FO_INDUCTANCE + 2,            /* number of parameters                              */
    FO_NS = FO_INDUCTANCE - FO_RESISTANCE, /* number of parameters that change the volt-seconds */
    FO_NF = 2 * FO_N,      /* order of the fast filter: flux, drift                */
    FO_NA = FO_NF + FO_NP, /* order of the factor: fast filter, then parameters    */
    FO_NM = 2 * FO_N + 1,  /* manifold: flux, drift, square of the magnet flux     */
    FO_NW = FO_N + 1,      /* weights of a block's rows: 1, gradient by the flux   */
    FO_CANDIDATES = 4      /* positions at the start of the fit                    */
};

/* Choice of the time when the information is projected on the manifold. */
typedef enum {
    FO_PROJECT_NEVER, /* the start waits for the plain observer's position */
    FO_PROJECT_START  /* projection until the position is known            */
} fo_projection;

/* Assumed values of machine and inverter with their standard deviations (0 if a value is known),
 * and the time of the projection. */
#define FO_ADAPTIVE_CONFIG_FIELDS(NUMBER)                                                        \
    NUMBER(saliency)         /* L_d - L_position [H]                                          */ \
    NUMBER(L_d_std)          /* std of the inductance along d, as a share of it [1]           */ \
    NUMBER(L_q_std)          /* std of the inductance along q, as a share of it [1]           */ \
    NUMBER(lag_std)          /* std of the delay of a voltage [s]                             */ \
    NUMBER(delay_std)        /* std of the delay of a current [s]                             */ \
    NUMBER(current_gain_std) /* std of a component of g in i' = i + g conj(i) [1]             */ \
    NUMBER(iron_current_std) /* std of the current of the iron loss [A]                       */ \
    NUMBER(harmonic_std)     /* std of the magnet flux's 5th and 7th harmonics, as a share [1] */ \
    NUMBER(psi_f)            /* magnet flux [Wb]; 0 without magnets                           */ \
    NUMBER(psi_f_std)        /* std of the magnet flux [Wb]; 0 without magnets                */ \
    NUMBER(resistance_std)   /* std of the resistance [Ohm]                                   */ \
    NUMBER(inverter_voltage) /* dead time and device drops of a phase [V]                     */ \
    NUMBER(inverter_std)     /* std of inverter_voltage [V]                                   */ \
    NUMBER(inverter_current) /* the sign of a phase current i is nearly tanh(i / this) [A]    */ \
    NUMBER(offset_std)       /* std of the offset of a current component [A]                  */ \
    NUMBER(asymmetry_std)    /* std of both components of g in u' = u + g conj(u) [1]         */ \
    NUMBER(slow_memory)      /* time in which a parameter may change by one std [s] */

typedef struct {
    FO_ADAPTIVE_CONFIG_FIELDS(FO_NUMBER_FIELD)
    fo_projection projection;
} fo_adaptive_config;

/* The fields after the plain observer; treat them as opaque. They are per-unit unless stated. */
#define FO_ADAPTIVE_FIELDS(ARRAY, NUMBER)                                                        \
    NUMBER(saliency, "L_d - L_q, per ampere")                                                    \
    NUMBER(psi, "assumed magnet flux")                                                           \
    ARRAY(std, FO_NP, "prior std: 1, ohm, volt, volt, ampere, ampere, 1, 1, 1, 1")               \
    NUMBER(inverter_mean, "assumed loss of each part of the inverter [V]")                       \
    NUMBER(volt, "one volt over a sample")                                                       \
    ARRAY(over_current, 2, "1 / currents at which the parts of the inverter's loss saturate "    \
                           "[1/A]")                                                              \
    NUMBER(over_rated, "1 / rated current [1/A]")                                                \
    NUMBER(lag_std, "std of the lag [s]")                                                        \
    NUMBER(delay_std, "std of the delay of the currents [s]")                                    \
    NUMBER(current_gain_std, "std of unequal gains of the current sensors")                      \
    NUMBER(iron_flux, "armature flux of the iron loss")                                          \
    NUMBER(magnet_error, "harmonics of the magnet flux")                                         \
    NUMBER(through_L, "variance of a residual from current noise")                               \
    NUMBER(unmodelled, "voltage error that is in no model")                                      \
    NUMBER(slow, "memory / slow memory")                                                         \
    NUMBER(guard_reinject, "share of the prior re-injected per turn, with a row in two samples") \
    ARRAY(guard_track, 3, "gains of the tracker for two samples")

typedef struct {
    fo_observer plain;
    FO_ADAPTIVE_FIELDS(FO_ARRAY_PARAMETER, FO_NUMBER_PARAMETER)
    fo_projection projection;
} fo_adaptive;

/* ---- two tasks ------------------------------------------------------------------------------
 * The interrupt integrates flux and position and sums the rows of a block. The learner, a function
 * that a slower task may call, updates the information factor by a block, and fits the candidates
 * at the start. They exchange one mail, which belongs to one of them at a time. */

/* Sums of a block. It begins where the learner's last block ended; that instant is the reference of
 * the learner's corrections. */
typedef struct {
    uint32_t samples;
    fo_real time;                         /* [memories]                                        */
    fo_real turned;                       /* rotation [rad]                                    */
    fo_real sensitivity[FO_NS][FO_N];     /* of the flux to parameters [1 / their units]       */
    fo_real unmodelled;                   /* integral of the voltage error outside the model   */
    fo_real volt_seconds[FO_N];           /* before the filter runs                            */
} fo_block;

/* Sums over the samples of a block for the row of the direction. If the flux across the rotor's d
 * axis is wrong by e, the angle is wrong by e u, where u = 1 / |x|: where the current along d
 * ripples, the angle ripples with u. du is the change of u in a sample, r that of the angle without
 * the rotor's rotation. */
typedef struct {
    uint32_t samples;
    fo_real product;                      /* du r                                              */
    fo_real square, lagged;               /* du du; du and that of the sample before           */
    fo_real h[FO_N], th[FO_N];            /* du du times the unit vector across x; times t     */
    fo_real signs[2];                     /* du u times the phase currents' signs across x     */
} fo_ripple;

/* Sums over the samples of a block with a measured current. h is the gradient of the residual
 * |x| - saliency i_d - psi_f by the flux, t the time. The weights w are 1, h_0, h_1: within more
 * than a quarter of a turn they are different rows. */
typedef struct {
    uint32_t samples;
    fo_real h[FO_N], hh[3];               /* h; h_0 h_0, h_0 h_1, h_1 h_1                      */
    fo_real th[FO_N], thh[3];
    fo_real residual[FO_NW];              /* w residual                                        */
    fo_ripple ripple;
    fo_real by_parameter[FO_NP - 1][FO_NW]; /* w times derivatives by all but psi_f [1 / units] */
} fo_sums;

/* A candidate: one hypothesis of flux and drift at the start. */
typedef struct {
    fo_real p[FO_NM];        /* flux, drift, square of the magnet flux           */
    fo_real cost;            /* misfit to the information                        */
    fo_real predicted_cost;  /* misfit after the next Gauss-Newton step          */
    fo_real variance;        /* variance of the angle [rad^2]                    */
    fo_real theta;           /* angle after its last step [rad]                  */
    uint32_t age;            /* steps since it was placed                        */
} fo_candidate;

typedef struct {
    fo_candidate candidates[FO_CANDIDATES];
    uint32_t next;           /* candidate of the next step                       */
    uint32_t confirmations;  /* candidates that converged to the best candidate  */
    int32_t best;            /* index of the best candidate                      */
} fo_search;

/* At the end of a block. */
typedef struct {
    fo_real flux[FO_N];                   /* the filter's flux                                 */
    fo_real current[FO_N];                /* [A]                                               */
    fo_real mean_current[FO_N];           /* of the last interval [A]                          */
    fo_real signs[2][FO_N];               /* soft signs of the phase currents, for the loss    */
    fo_real noise_inflation;
    fo_real emf_ratio;                    /* integral of voltage_std / EMF [rad]               */
    fo_real speed;                        /* [rad/s]                                           */
#if FO_MAPPED
    fo_map_point map_point;
#endif
} fo_block_end;

/* The plain observer before the filter runs. */
typedef struct {
    fo_information info;
    fo_real power;
    fo_real flux[FO_N], drift[FO_N];      /* its solution                                      */
    fo_real armature_flux[FO_N];
    fo_real direction[FO_N];              /* last known direction of the rotor                 */
    fo_real rotation;                     /* rotation since one candidate is likely [rad]      */
    bool trusted, settled;
} fo_search_data;

/* What the interrupt needs from the learner between two blocks. */
typedef struct {
    fo_real variance_across;              /* variance of the flux across x, with L_q known     */
    fo_real growth;                       /* growth of variance_across per squared memory      */
    fo_real variance_by_L_q;              /* variance that the error of L_q adds               */
    fo_real armature_flux_q;              /* armature flux at which variance_by_L_q holds      */
    fo_real reported_std[3];              /* stds of psi_f, resistance, inverter's loss        */
    fo_real loss_size;                    /* estimate and std of the inverter's loss           */
    fo_real voltage_std;                  /* std of the voltage due to the parameters          */
    fo_real voltage_std_square;           /* squared current at which voltage_std holds [A^2]  */
    fo_real drift_std;                    /* std of the drift / its prior std                  */
    fo_real innovation_power;             /* power of the parameters' innovations / variance   */
    fo_real rows;                         /* measurement rows since the start                  */
    fo_real direction_gain;               /* share of the flux error that the last row of the
                                           * direction removed                                 */
    fo_real tilt;                         /* variance of the axis that this row tells [rad^2]  */
} fo_learning_report;

typedef enum {
    FO_ANSWER_NONE,       /* no candidate has converged                                        */
    FO_ANSWER_CANDIDATE,  /* flux and drift of the best candidate                              */
    FO_ANSWER_START,      /* the filter starts with this flux and drift                        */
    FO_ANSWER_CORRECTION  /* corrections of the filter's flux and drift                        */
} fo_answer_kind;

typedef struct {
    fo_answer_kind kind;
    fo_real flux[FO_N], drift[FO_N];      /* at the learner's reference                        */
    fo_real change[FO_NP];                /* change of the parameters [their units]            */
    fo_real value[FO_NP];                 /* errors of the parameters [their units]            */
    fo_real length;                       /* of a candidate's position vector                  */
    fo_real variance;                     /* of a candidate's angle [rad^2]                    */
    fo_real means[3];                     /* prior means to which `value` is relative          */
    fo_real other_theta, other_weight;    /* second candidate; weight 1/2: not decided         */
    bool other_direction;                 /* another candidate has become the best             */
    bool wrong;                           /* the numbers have become implausible               */
    fo_learning_report report;
} fo_answer;

typedef struct {
    volatile uint32_t owner;              /* free, with the learner, or answered               */
    bool searching;                       /* `data.search`, else `data.sums`                   */
    bool place;                           /* place the candidates anew                         */
    bool forget;                          /* reset the parameters to their prior               */
    fo_block block;
    fo_block_end end;
    union {
        fo_sums sums;
        fo_search_data search;
        fo_answer answer;
    } data;
} fo_mail;

/* State that only the learner accesses. */
typedef struct {
    /* Information factor. Flux and drift are relative to their estimates. Parameters are relative
     * to their prior mean, in units of their prior std. */
    fo_real U[FO_PACKED(FO_NA)], d[FO_NA], z[FO_NA];
    fo_real p[FO_NP];                    /* the estimates                                   */
    fo_real means[3];                    /* prior means to which they are relative          */
    bool frozen;                         /* the parameters are not updated                  */
    uint32_t reinject_index;             /* parameter whose prior is re-injected next       */
    uint32_t report_index;               /* index of the std that is updated next           */
    fo_real forgotten;                   /* share of the information forgotten in this round */
    fo_real forgotten_before;            /* share of the information forgotten in the last round */
    fo_real noise_level;                 /* power of the filter's innovations / assumed power */
    fo_real operating_point[3];          /* i_d, i_q [A], electrical turn per memory        */
    fo_real rows_at_point;               /* measurement rows at this operating point        */
    fo_learning_report report;
} fo_learner;

/* State of the adaptive observer: everything that changes. The state is plain data that may be
 * copied, stored and restored between two calls. Only the interrupt accesses the fields up to the
 * mail. */
typedef struct {
    fo_state plain;
    bool running;                        /* the filter runs; else candidates are fitted     */
    bool has_candidate;                  /* flux and drift are those of a candidate         */
    bool seeded;                         /* the plain observer integrates from a seed       */
    bool discard;                        /* the learner's next answer is too late           */
    bool place, forget;                  /* for the next mail                               */
    uint32_t sample_index;
    uint32_t restarts;                   /* restarts of the filter by its guard             */
    fo_real flux[FO_N], drift[FO_N];     /* the filter's estimates                          */
    fo_real value[FO_NP];                /* errors of the parameters [their units]          */
    fo_real x[FO_N], theta;              /* direction of the position vector                */
    fo_tracker tracker;
    fo_real inverse_length, ripple;      /* 1 / |x| of the last sample, its last change     */
    uint32_t ripple_samples;             /* samples in a row with an angle and a current    */
    fo_real emf_ratio;                   /* integral of voltage_std / EMF [rad]             */
    fo_real voltage_turn;                /* turn of the flux by unmodelled voltages [rad]   */
    fo_real signs[2][FO_N];              /* soft signs of the phase currents, for the loss  */
    fo_real loss_gradient[3];            /* of the loss over a sample by the current [1/A]  */
    fo_real std;                         /* std of the filter's angle [rad]                 */
    fo_reason reason;                    /* why the filter's position is not valid          */
    fo_real rotation;                    /* rotation since one candidate is likely [rad]    */
    fo_merged merged;                    /* interval without a row of the guard             */
    fo_real disagreement;                /* turn during which filter and guard differ [rad] */
    fo_real confirmed;                   /* rotation since the position became certain [rad] */
    uint32_t uncertain;                  /* samples in a row without a certain position     */
    fo_real half_turn;                   /* weight of the angle half a turn away            */
    fo_real length, variance;            /* of the best candidate                           */
    fo_real other_theta, other_weight;   /* second candidate                                */
    fo_learning_report report;           /* the learner's last report                       */
    fo_block block;
    union {
        fo_sums sums;                    /* while the filter runs: for the interrupt        */
        fo_search search;                /* before: for the learner                         */
    } now;
#if FO_MAPPED
    fo_map_point map_point;              /* the map at the filter's own angle               */
#endif
    fo_mail mail;
    fo_learner learner;
} fo_adaptive_state;

typedef struct {
    fo_estimate position;     /* estimates that the plain observer also has                   */
    fo_real drift_std;        /* std of a drift component [V]                                 */
    fo_real psi_f, psi_f_std; /* magnet flux; active flux until the former is known [Wb]      */
    fo_real resistance_error; /* true minus assumed [Ohm]                                     */
    fo_real resistance_std;
    fo_real inverter_voltage; /* [V]                                                          */
    fo_real inverter_std;
    fo_real theta_other;      /* second angle while two angles are possible [rad]             */
    fo_real weight_other;     /* weight of the second angle, 0 to 1/2                         */
    bool adapting;            /* the filter runs                                              */
} fo_adaptive_estimate;

/* Learnt values: every parameter with its standard deviation. */
#define FO_LEARNT_FIELDS(VECTOR, NUMBER)                       \
    NUMBER(psi_f)            /* [Wb]                        */ \
    NUMBER(psi_f_std)                                          \
    NUMBER(resistance_error) /* true minus assumed [Ohm]    */ \
    NUMBER(resistance_std)                                     \
    NUMBER(inverter_voltage) /* [V]                         */ \
    NUMBER(inverter_std)                                       \
    VECTOR(offset)           /* offset of the measured current [A] */ \
    VECTOR(offset_std)                                         \
    VECTOR(asymmetry)        /* component of g in u' = u + g conj(u) [1] */ \
    VECTOR(asymmetry_std)                                      \
    VECTOR(inductance_error) /* errors of L_d and L_q, as shares [1] */ \
    VECTOR(inductance_std)

typedef struct {
    FO_LEARNT_FIELDS(FO_VECTOR_FIELD, FO_NUMBER_FIELD)
} fo_learnt;

/* Like the functions fo_init, fo_wrong, fo_reset, fo_step, fo_step_volt_seconds and fo_step_for. */
fo_error fo_adaptive_init(fo_adaptive *observer, const fo_config *config,
                          const fo_adaptive_config *adaptive);
const char *fo_adaptive_wrong(const fo_config *config, const fo_adaptive_config *adaptive);
void fo_adaptive_reset(const fo_adaptive *observer, fo_adaptive_state *state);

/* Resets the state as after a power cycle, but keeps what has been learnt. If `frozen`, the learnt
 * values do not change any more. */
void fo_adaptive_restart(const fo_adaptive *observer, fo_adaptive_state *state, bool frozen);

/* Processes one sample, with all its work in this call: a fast step, then fo_adaptive_learn. */
void fo_adaptive_step(const fo_adaptive *observer, fo_adaptive_state *state,
                      const fo_real voltage[FO_N], const fo_real current[FO_N],
                      fo_adaptive_estimate *estimate);
void fo_adaptive_step_volt_seconds(const fo_adaptive *observer, fo_adaptive_state *state,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *estimate);
void fo_adaptive_step_for(const fo_adaptive *observer, fo_adaptive_state *state, fo_real duration,
                          const fo_real voltage[FO_N], const fo_real current[FO_N],
                          fo_adaptive_estimate *estimate);

/* In two tasks: the interrupt calls a fast step for each sample, and a slower task of lower priority
 * calls fo_adaptive_learn at 200 Hz or more. The interrupt may preempt the task at any instruction,
 * and the task may be late: a block lasts until the learner has received it. Returns whether there
 * was work. */
void fo_adaptive_fast_step(const fo_adaptive *observer, fo_adaptive_state *state,
                           const fo_real voltage[FO_N], const fo_real current[FO_N],
                           fo_adaptive_estimate *estimate);
void fo_adaptive_fast_step_volt_seconds(const fo_adaptive *observer, fo_adaptive_state *state,
                                        const fo_real volt_seconds[FO_N],
                                        const fo_real current[FO_N],
                                        fo_adaptive_estimate *estimate);
void fo_adaptive_fast_step_for(const fo_adaptive *observer, fo_adaptive_state *state,
                               fo_real duration, const fo_real voltage[FO_N],
                               const fo_real current[FO_N], fo_adaptive_estimate *estimate);
bool fo_adaptive_learn(const fo_adaptive *observer, fo_adaptive_state *state);

/* Writes the learnt values. Not while fo_adaptive_learn runs. */
void fo_adaptive_learnt(const fo_adaptive *observer, const fo_adaptive_state *state,
                        fo_learnt *learnt);

#ifdef __cplusplus
}
#endif

#endif
