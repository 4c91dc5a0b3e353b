/* fluxobs, configuration: computes fo_config and fo_adaptive_config from the parameters of a
 * machine. The library calls the same functions. They are for firmware whose motor is chosen in the
 * field; an export contains its parameters and does not need them.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CONFIG_H
#define FLUXOBS_CONFIG_H

#include "fluxobs_observers.h"

#ifdef __cplusplus
extern "C" {
#endif

#define fo_sizes FO_NAME(fo_sizes)
#define fo_machine FO_NAME(fo_machine)
#define fo_kink_weights FO_NAME(fo_kink_weights)
#define fo_choose FO_NAME(fo_choose)
#define fo_adaptive_choose FO_NAME(fo_adaptive_choose)
#define fo_pmsm FO_NAME(fo_pmsm)
#define fo_ipmsm FO_NAME(fo_ipmsm)
#define fo_synrm FO_NAME(fo_synrm)
#define fo_induction FO_NAME(fo_induction)
#define fo_configure FO_NAME(fo_configure)
#define fo_map_of FO_NAME(fo_map_of)

/* Usual settings, and shares that replace missing parameters: value and meaning. */
#define FO_USUAL(X)                                                                              \
    X(MEMORY, 0.03)          /* memory [s]: suited every record tried, 75 to 5000 rad/s       */ \
    X(TRACKER, 20.0)         /* tracker bandwidth times memory: follows load steps            */ \
    X(MODEL_ERROR, 0.003)    /* smallest error of any machine's relation [flux squared]       */ \
    X(CURRENT_NOISE, 0.002)  /* noise of a current component [rated current]                  */ \
    X(CURRENT_LIMIT, 20.0)   /* limit of a plausible current [rated current]                  */ \
    X(CURRENT_FLUX, 5.0)     /* the same limit, if larger: flux L i of the current [flux]     */ \
    X(DRIFT_DROP, 0.03)      /* largest plausible drift [rated resistive drop]                */ \
    X(DRIFT_TURN, 0.1)       /* the same limit, if larger: turn of the flux in a memory [rad] */ \
    X(MATTERS, 0.15)         /* from this R h/L on, a voltage counts as held                  */ \
    X(WALK, 3.5)             /* longest quiet memory / ((L/R)^2 / h)                          */ \
                             /* (noise of the resistive drop stays below that of L i)         */ \
    X(SLOW, 4.0)             /* the memory holds a turn at the usual speed divided by this    */ \
    X(MAGNETIZING, 0.45)     /* a cage's rated flux / (L_M times rated current)               */ \
    X(RELUCTANCE, 0.5)       /* i_d of a reluctance machine at rated current [rated]          */ \
    X(SHORTEST, 0.25)        /* shortest usable position vector [flux]                        */ \
    X(SHORTEST_SALIENT, 0.05) /* the same limit for a reluctance machine [flux]               */ \
    X(STILL, 0.15)           /* change of i_d up to which a cage's flux is constant [flux/L_M] */ \
    X(CAGE_OFFSET, 0.01)     /* std of a cage's current offsets, which turn its flux [rated]  */ \
    X(OFFSET_SHARE, 0.02)    /* std of a current offset [rated current]                       */ \
    X(RESISTANCE_SHARE, 0.5) /* std of the resistance [resistance]                            */ \
    X(PSI_SHARE, 0.25)       /* std of the magnet flux [magnet flux]                          */ \
    X(INDUCTANCE_SHARE, 0.1) /* std of an inductance [inductance]                             */ \
    X(INVERTER_SHARE, 0.25)  /* std of the inverter's loss [rated resistive drop]             */ \
    X(DC_LINK_SHARE, 0.02)   /* least std of the inverter's loss [DC link]                    */ \
    X(ASYMMETRY_STD, 0.01)   /* std of the asymmetry of the phases [1]                        */ \
    X(LAG_STD, 0.15)         /* std of the delay of a voltage [samples]                       */ \
    X(DELAY_STD, 0.2)        /* std of the delay of a current [samples]                       */ \
    X(CURRENT_GAIN_STD, 0.01) /* std of unequal gains of the current sensors [1]              */ \
    X(IRON_SHARE, 0.01)      /* std of the current of the iron loss [rated current]           */ \
    X(HARMONIC_STD, 0.015)   /* std of the 5th and 7th harmonics [magnet flux]                */ \
    X(SMOOTHING, 0.05)       /* a current's sign is smoothed below this [rated current]       */ \
    X(SLOW_MEMORY, 100.0)    /* time in which a parameter may change by one std [s] */

/* Sizes of a machine that determine its usual settings. */
#define FO_SIZES_FIELDS(NUMBER)                                                            \
    NUMBER(resistance)    /* of a phase [Ohm]                                           */ \
    NUMBER(inductance)    /* inductance that limits current steps [H]                   */ \
    NUMBER(L_position)    /* L in the position vector flux - L i [H]                    */ \
    NUMBER(flux)          /* size of the flux [Wb]                                      */ \
    NUMBER(slope)         /* slope of the constraint over the current, at this flux [Wb^2/A] */ \
    NUMBER(shortest)      /* shortest usable position vector [flux]                     */ \
    NUMBER(rated_current) /* peak of a phase [A]                                        */ \
    NUMBER(usual_memory)  /* [s]                                                        */ \
    NUMBER(speed_e)       /* usual electrical speed [rad/s]; 0: unknown */

typedef struct {
    FO_SIZES_FIELDS(FO_NUMBER_FIELD)
} fo_sizes;

/* Is each voltage held over its sample, like the mean voltage of an inverter? */
typedef enum {
    FO_VOLTAGE_AUTO,   /* held if R h/L is large */
    FO_VOLTAGE_HELD,
    FO_VOLTAGE_SMOOTH
} fo_voltage;

/* Chooses those of memory, current_noise and drift_prior that are 0 in the configuration, and the
 * settings that follow from them and the sizes. sample_time must be set. */
void fo_choose(fo_config *config, const fo_sizes *sizes, fo_voltage voltage);

/* Returns two weights: the shares of a held voltage's last step, and of the step before it, in the
 * error of the resistive drop. The error is that of the cubic through four current samples; `share`
 * is R h/L (docs/theory.md, section 5). */
void fo_kink_weights(fo_real share, fo_real weights[2]);

/* ---- machines --------------------------------------------------------------------------- */

typedef enum { FO_MAGNETS, FO_RELUCTANCE, FO_CAGE } fo_kind;

/* Parameters of a machine: per phase (star), SI, amplitude-invariant. */
typedef struct {
    fo_kind kind;
    fo_real R_s, L_d, L_q; /* of a cage, each is the leakage inductance */
    fo_real psi;           /* magnet flux, or a cage's rated flux [Wb]  */
    fo_real R_R, L_M;      /* only of a cage: rotor and magnetizing branch */
    fo_real rated_current; /* peak current [A]; a factor of two does no harm */
    fo_real speed_e;       /* usual electrical speed [rad/s], 0: unknown; needed where L/R is
                            * short */
} fo_machine;

/* Machines: surface and interior PMSM, synchronous reluctance machine (L_d > L_q), induction
 * machine (inverse-Gamma model; psi_R = 0 means 0.45 L_M rated_current). */
fo_machine fo_pmsm(fo_real R_s, fo_real L_s, fo_real psi_f, fo_real rated_current);
fo_machine fo_ipmsm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real psi_f, fo_real rated_current);
fo_machine fo_synrm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real rated_current);
fo_machine fo_induction(fo_real R_s, fo_real R_R, fo_real L_sigma, fo_real L_M, fo_real psi_R,
                        fo_real rated_current);

/* Makes the whole configuration of a machine, for fo_init. Returns NULL on success. Otherwise
 * returns the name of a field of fo_machine that is implausible or most likely has a wrong unit;
 * the configuration is then zero, and fo_init refuses it. The name may also be "sample_time", or
 * "psi or rated_current" where either may be wrong. */
const char *fo_configure(fo_config *config, const fo_machine *machine, fo_real sample_time);

#if FO_MAPPED
/* Makes the machine's flux map, for fo_use_map. Returns false if the machine needs no map: it has
 * no magnets or no saliency. With the adaptive observer only a cage needs a map. */
bool fo_map_of(fo_map *map, const fo_machine *machine, fo_real sample_time);
#endif

#if FO_ADAPTIVE
/* Parameters that the adaptive observer may learn besides drift, magnet flux, offsets and
 * inductances. */
typedef enum { FO_LEARN_RESISTANCE = 1, FO_LEARN_INVERTER = 2, FO_LEARN_ASYMMETRY = 4 } fo_unknown;

/* Makes the usual fo_adaptive_config. `learn` is a sum of fo_unknown; `dc_link` [V] may be 0. The
 * inverter's loss is assumed to be 0: if it is known, set inverter_voltage afterwards. */
void fo_adaptive_choose(fo_adaptive_config *adaptive, const fo_machine *machine,
                        fo_real sample_time, fo_real dc_link, uint32_t learn);
#endif

#ifdef __cplusplus
}
#endif

#endif
