/* fluxobs, configuration: from the numbers of a machine to fo_config and fo_adaptive_config, by the
 * formulas of the library, which calls these functions. For a firmware whose motor is chosen in the
 * field; an export has its parameters ready and needs none of this.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CONFIG_H
#define FLUXOBS_CONFIG_H

#include "fluxobs.h"

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

/* Usual settings, and shares for what is not given: value and meaning of each. */
#define FO_USUAL(X)                                                                              \
    X(MEMORY, 0.03)          /* memory [s]: suited every record tried, 75 to 5000 rad/s       */ \
    X(TRACKER, 20.0)         /* tracker's bandwidth times the memory: it follows load steps   */ \
    X(MODEL_ERROR, 0.003)    /* no machine satisfies its relation better [flux squared]       */ \
    X(CURRENT_NOISE, 0.002)  /* noise of a current component [rated current]                  */ \
    X(CURRENT_LIMIT, 20.0)   /* a current beyond it is garbage [rated current], ...           */ \
    X(CURRENT_FLUX, 5.0)     /* ... if its own flux, L i, is beyond this too [flux]           */ \
    X(DRIFT_DROP, 0.03)      /* largest plausible drift [rated resistive drop], at least ...  */ \
    X(DRIFT_TURN, 0.1)       /* ... what turns the flux by this within the memory [rad]       */ \
    X(MATTERS, 0.15)         /* R h/L from which voltages are taken as held over a sample     */ \
    X(WALK, 3.5)             /* quiet memory over (L/R)^2 / h: noise in the resistive drop    */ \
                             /* then stays below that in L i                                  */ \
    X(SLOW, 4.0)             /* the memory holds a turn at the usual speed over this          */ \
    X(MAGNETIZING, 0.45)     /* rated flux of a cage over L_M times rated current             */ \
    X(RELUCTANCE, 0.5)       /* i_d of a reluctance machine at rated current [of it]          */ \
    X(SHORTEST, 0.25)        /* shortest usable position vector [flux], ...                   */ \
    X(SHORTEST_SALIENT, 0.05) /* ... of a reluctance machine, whose length follows i_d        */ \
    X(STILL, 0.15)           /* change of a cage's i_d below which its flux stands [flux/L_M] */ \
    X(CAGE_OFFSET, 0.01)     /* std of a cage's current offsets, which turn it [rated]        */ \
    X(OFFSET_SHARE, 0.02)    /* std of a current offset [rated current]                       */ \
    X(RESISTANCE_SHARE, 0.5) /* std of the resistance [of it]                                 */ \
    X(PSI_SHARE, 0.25)       /* std of the magnet flux [of it]                                */ \
    X(INDUCTANCE_SHARE, 0.1) /* std of an inductance [of it]                                  */ \
    X(INVERTER_SHARE, 0.25)  /* std of the inverter's loss [rated resistive drop], ...        */ \
    X(DC_LINK_SHARE, 0.02)   /* ... at least this [DC link]                                   */ \
    X(ASYMMETRY_STD, 0.01)   /* std of the asymmetry of the phases [1]                        */ \
    X(LAG_STD, 0.15)         /* std of the time by which a voltage comes late [samples]       */ \
    X(SMOOTHING, 0.05)       /* the sign of a current is smoothed below it [rated current]    */ \
    X(SLOW_MEMORY, 100.0)    /* time in which a parameter may change by one std [s]           */

/* What the usual settings of a machine depend on. */
#define FO_SIZES_FIELDS(NUMBER)                                                            \
    NUMBER(resistance)    /* of a phase [Ohm]                                           */ \
    NUMBER(inductance)    /* that a step of the voltage meets [H]                       */ \
    NUMBER(L_position)    /* of the position vector flux - L i [H]                      */ \
    NUMBER(flux)          /* size of the flux [Wb]                                      */ \
    NUMBER(slope)         /* of the constraint over the current, at this flux [Wb^2/A]  */ \
    NUMBER(shortest)      /* shortest usable position vector [flux]                     */ \
    NUMBER(rated_current) /* peak of a phase [A]                                        */ \
    NUMBER(usual_memory)  /* [s]                                                        */ \
    NUMBER(speed_e)       /* usual electrical speed [rad/s]; 0 if it is not known       */

typedef struct {
    FO_SIZES_FIELDS(FO_NUMBER_FIELD)
} fo_sizes;

/* Is each voltage held over its sample, as an inverter's mean voltage is? */
typedef enum {
    FO_VOLTAGE_AUTO,   /* if it matters: where R h/L is large */
    FO_VOLTAGE_HELD,
    FO_VOLTAGE_SMOOTH
} fo_voltage;

/* Chooses the settings that are 0 in a configuration whose sample_time is given: memory,
 * current_noise, drift_prior; and those that follow from them and the sizes. */
void fo_choose(fo_config *config, const fo_sizes *sizes, fo_voltage voltage);

/* Share of the last step of a held voltage, and of the one before it, in what the cubic through
 * four current samples misses of the resistive drop; `share` is R h/L (docs/theory.md, section
 * 5). */
void fo_kink_weights(fo_real share, fo_real weights[2]);

/* ---- machines --------------------------------------------------------------------------- */

typedef enum { FO_MAGNETS, FO_RELUCTANCE, FO_CAGE } fo_kind;

/* A machine: per phase (star), SI, amplitude-invariant. */
typedef struct {
    fo_kind kind;
    fo_real R_s, L_d, L_q; /* of a cage: both the leakage inductance    */
    fo_real psi;           /* magnet flux or a cage's rated flux [Wb]   */
    fo_real R_R, L_M;      /* cage only: rotor and magnetizing branch   */
    fo_real rated_current; /* peak [A]; like psi a scale: a factor of two does no harm */
    fo_real speed_e;       /* usual electrical speed [rad/s], 0: not known. Matters where L/R is short */
} fo_machine;

/* Surface and interior PMSM, synchronous reluctance machine (L_d > L_q), induction machine
 * (inverse-Gamma model; psi_R 0: 0.45 L_M rated_current). */
fo_machine fo_pmsm(fo_real R_s, fo_real L_s, fo_real psi_f, fo_real rated_current);
fo_machine fo_ipmsm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real psi_f, fo_real rated_current);
fo_machine fo_synrm(fo_real R_s, fo_real L_d, fo_real L_q, fo_real rated_current);
fo_machine fo_induction(fo_real R_s, fo_real R_R, fo_real L_sigma, fo_real L_M, fo_real psi_R,
                        fo_real rated_current);

/* The whole configuration of a machine, for fo_init. Returns NULL, or the field of fo_machine that
 * no machine has, or whose unit is most likely wrong ("sample_time" too; "psi or rated_current"
 * where they cannot be told apart). The configuration is then zero, and fo_init refuses it. */
const char *fo_configure(fo_config *config, const fo_machine *machine, fo_real sample_time);

#if FO_MAPPED
/* Its flux map, for fo_use_map. Returns false if the machine needs none: no magnets, or no
 * saliency. With the adaptive observer only a cage needs one. */
bool fo_map_of(fo_map *map, const fo_machine *machine, fo_real sample_time);
#endif

#if FO_ADAPTIVE
/* What the adaptive observer learns beyond drift, magnet flux, offsets and inductances. */
typedef enum { FO_LEARN_RESISTANCE = 1, FO_LEARN_INVERTER = 2, FO_LEARN_ASYMMETRY = 4 } fo_unknown;

/* The usual fo_adaptive_config; `learn` is a sum of fo_unknown, `dc_link` [V] may be 0. The loss of
 * the inverter is assumed as 0: set inverter_voltage afterwards if it is known. */
void fo_adaptive_choose(fo_adaptive_config *adaptive, const fo_machine *machine,
                        fo_real sample_time, fo_real dc_link, uint32_t learn);
#endif

#ifdef __cplusplus
}
#endif

#endif
