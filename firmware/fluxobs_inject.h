/* fluxobs, injection: start of a salient machine from rest, and its position at rest.
 *
 * A square wave of voltage, alternating from sample to sample, makes the current ripple. A machine
 * whose inductances differ answers along its d axis. This file finds the axis, then the polarity by
 * saturation, starts the observer there, and keeps the current along d rippling while the observer
 * needs it. Theory: docs/theory.md, "The direction at rest".
 *
 *     fo_adaptive_step(&observer, &state, voltage, current, &estimate);
 *     fo_inject(&injector, &injecting, &estimate, voltage, current, &injection);
 *     if (injection.start) {
 *         fo_adaptive_seed_state(&observer, &state, &injection.seed, current);
 *     }
 *
 * The controller regulates `injection.current`, which has no ripple, to its reference plus
 * `injection.bias`, and adds `injection.voltage` to its command. It asks for torque only while
 * `injection.ready`.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_INJECT_H
#define FLUXOBS_INJECT_H

#include "fluxobs_seed.h"

#if FO_ADAPTIVE

#ifdef __cplusplus
extern "C" {
#endif

#define fo_injector_config FO_NAME(fo_injector_config)
#define fo_injector FO_NAME(fo_injector)
#define fo_injector_state FO_NAME(fo_injector_state)
#define fo_injection FO_NAME(fo_injection)
#define fo_injector_init FO_NAME(fo_injector_init)
#define fo_injector_reset FO_NAME(fo_injector_reset)
#define fo_inject FO_NAME(fo_inject)

#define FO_INJECTOR_FIELDS(NUMBER)                                                                  \
    NUMBER(sample_time)   /* period of the samples, of the voltages and of the carrier [s]      */ \
    NUMBER(L_d)           /* incremental inductances without current [H]                        */ \
    NUMBER(L_q)                                                                                    \
    NUMBER(psi_f)         /* magnet flux; 0: a reluctance machine, which has no polarity [Wb]   */ \
    NUMBER(current)       /* largest amplitude of the ripple along d [A]                        */ \
    NUMBER(voltage)       /* largest amplitude of the injected voltage: what the controller     */ \
                          /* leaves of the DC link [V]                                          */ \
    NUMBER(bias)          /* current along d: for the test of polarity (0: no test), or the     */ \
                          /* magnetizing current of a reluctance machine [A]                    */ \
    NUMBER(current_noise) /* std of the noise of a current component [A]                        */ \
    NUMBER(std)           /* demanded std of the angle [rad]                                    */ \
    NUMBER(speed)         /* electrical speed above which nothing is injected [rad/s]           */

typedef struct {
    FO_INJECTOR_FIELDS(FO_NUMBER_FIELD)
} fo_injector_config;

typedef struct {
    fo_injector_config config;
    fo_real volts;        /* amplitude of the voltage per amplitude of the current [V/A] */
    fo_real most;         /* largest amplitude of the current [A]                        */
    fo_real saliency;     /* 1 - L_q / L_d                                               */
    fo_real axis_weight;  /* squared volt-seconds that tell the axis [V^2 s^2]           */
    fo_real noise_square; /* variance of a demodulated second difference [A^2]           */
} fo_injector;

typedef enum {
    FO_INJECT_AXIS,  /* searching for the axis                                  */
    FO_INJECT_PLUS,  /* testing the polarity, with current along the found axis */
    FO_INJECT_MINUS, /* testing the polarity, with current against it           */
    FO_INJECT_RUN    /* the observer runs                                       */
} fo_inject_phase;

/* Treat as opaque. */
typedef struct {
    fo_inject_phase phase;
    uint32_t count;                     /* samples of this phase                          */
    uint32_t samples;                   /* measured samples of a test                     */
    uint32_t rounds;                    /* tests of polarity                              */
    uint32_t lost;                      /* samples in a row without the observer's filter */
    bool guessed;                       /* the polarity is open                           */
    bool moving;                        /* the observer has been lost: no rest is known   */
    bool ready;                         /* the observer's angle has become certain        */
    bool positive;                      /* sign of the voltage                            */
    fo_real amplitude;                  /* of the ripple [A]                              */
    fo_real cosine, sine, weight;       /* sums of the search                             */
    fo_real response[2], excitation[2]; /* sums of the tests, along the axis              */
    fo_real across;                     /* and of the response across it                  */
    fo_real theta, axis[FO_N];          /* the axis                                       */
    fo_real last[FO_N];                 /* expected direction of the next axis            */
    fo_real difference[FO_N];           /* of the last two currents                       */
    fo_real voltage[FO_N], current[FO_N]; /* of the last sample                           */
} fo_injector_state;

typedef struct {
    fo_real voltage[FO_N]; /* for the next interval, in addition to the controller's [V] */
    fo_real bias[FO_N];    /* in addition to the current reference [A]                   */
    fo_real current[FO_N]; /* without ripple: mean of two samples [A]                    */
    fo_seed seed;          /* where the observer starts                                  */
    bool start;            /* start it now                                               */
    bool ready;            /* the angle is certain but for, perhaps, half a turn: torque */
                           /* may be asked for                                           */
} fo_injection;

/* Returns whether the numbers can be used: finite, positive where they must be, and inductances that
 * differ by 2 % or more. A machine without saliency cannot be started in this way. */
bool fo_injector_init(fo_injector *injector, const fo_injector_config *config);

/* Call this while the rotor rests. The polarity is tested only in the first search after it; after a
 * loss the observer starts with an open half turn. */
void fo_injector_reset(fo_injector_state *state);

/* Call after the observer's step. `voltage` acted from the last sample to this one. */
void fo_inject(const fo_injector *injector, fo_injector_state *state,
               const fo_adaptive_estimate *estimate, const fo_real voltage[FO_N],
               const fo_real current[FO_N], fo_injection *injection);

#ifdef __cplusplus
}
#endif

#endif

#endif
