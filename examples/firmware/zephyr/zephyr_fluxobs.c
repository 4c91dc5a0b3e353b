/* fluxobs in a Zephyr application: a zero-latency interrupt at the end of the currents' conversion.
 *
 * Zephyr has no interface for a current control. The application sets up timer and ADC of an
 * STM32F405: TIM1 counts up and down with repetition counter 1, and three low-side shunts are
 * sampled at the timer's top. You write the functions that are declared here. A zero-latency
 * interrupt must not call the kernel; a thread fetches the position by fluxobs_zephyr_get.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 *
 * SPDX-License-Identifier: MIT
 */
#include <math.h>

#include "motor_observer.h"
#include "zephyr_declarations.h" /* in the firmware: zephyr/kernel.h, zephyr/irq.h, soc.h, stm32_ll_… */

struct fluxobs_position {
    float theta_e, speed_e; /* electrical [rad], [rad/s] */
    bool valid;             /* valid now, or within the last PATIENCE */
};

void motor_control(const float current[2], float udc, const struct fluxobs_position *position);
void fluxobs_zephyr_start(void);
struct fluxobs_position fluxobs_zephyr_get(void);

BUILD_ASSERT(IS_ENABLED(CONFIG_FPU_SHARING), "the interrupt spoils the threads' registers");

#define PATIENCE 0.01f                      /* time for which an old angle is trusted [s] */
#define COUNTS_AT_ZERO 2048.0f              /* counts of a shunt without current */
#define AMPERES_PER_COUNT (-3.3f / 4096.0f / (0.005f * 10.0f)) /* positive into the machine */
#define VOLTS_PER_COUNT (3.3f / 4096.0f * 31.0f)
/* Share of the period between a sample and the effect of its command. The timer loads new duties
 * half a period after the sample. Use 1.0f if the timer loads them at the sample, as with a
 * repetition counter that is shifted by one. */
#ifndef ACTS_AFTER
#define ACTS_AFTER 0.5f
#endif

static fo_state state;
static fo_estimate estimate;
static float before[2] = {NAN, NAN}; /* command two interrupts ago, alpha and beta [V]   */
static bool was_on;                  /* whether the gates were on in the last interrupt */
static float since_valid = 1e9f;     /* [s] */
static struct fluxobs_position shared;
static atomic_t times; /* how often `shared` has been written */

static void to_alpha_beta(float a, float b, float c, float factor, float result[2])
{
    result[0] = factor * (2.0f * a - b - c) / 3.0f;
    result[1] = factor * (b - c) * 0.57735027f;
}

ISR_DIRECT_DECLARE(fluxobs_adc_isr)
{
    float current[2], command[2], acting[2];
    const float udc = VOLTS_PER_COUNT * LL_ADC_INJ_ReadConversionData12(ADC1, LL_ADC_INJ_RANK_2);
    const bool on = LL_TIM_IsEnabledAllOutputs(TIM1) != 0;
    LL_ADC_ClearFlag_JEOS(ADC1);
    /* COUNTS_AT_ZERO cancels if it is the same for all shunts. */
    to_alpha_beta(LL_ADC_INJ_ReadConversionData12(ADC1, LL_ADC_INJ_RANK_1) - COUNTS_AT_ZERO,
                  LL_ADC_INJ_ReadConversionData12(ADC2, LL_ADC_INJ_RANK_1) - COUNTS_AT_ZERO,
                  LL_ADC_INJ_ReadConversionData12(ADC3, LL_ADC_INJ_RANK_1) - COUNTS_AT_ZERO,
                  AMPERES_PER_COUNT, current);

    /* The duties of the last interrupt are still in the compare registers. */
    to_alpha_beta((float)LL_TIM_OC_GetCompareCH1(TIM1), (float)LL_TIM_OC_GetCompareCH2(TIM1),
                  (float)LL_TIM_OC_GetCompareCH3(TIM1),
                  on && was_on ? udc / (float)LL_TIM_GetAutoReload(TIM1) : NAN, command);
    for (int n = 0; n < 2; n++) {
        acting[n] = ACTS_AFTER * before[n] + (1.0f - ACTS_AFTER) * command[n];
        before[n] = command[n];
    }
    was_on = on;

    fo_step(&motor_observer, &state, acting, current, &estimate);
    since_valid = estimate.valid ? 0.0f : since_valid + motor_observer.sample_time;
    shared.theta_e = estimate.theta_e_tracked;
    shared.speed_e = estimate.speed_e;
    shared.valid = since_valid < PATIENCE;
    (void)atomic_inc(&times);
    motor_control(current, udc, &shared); /* writes the new duties */
    return 0;                             /* nothing to schedule */
}

void fluxobs_zephyr_start(void)
{
    fo_reset(&motor_observer, &state);
    IRQ_DIRECT_CONNECT(ADC_IRQn, 0, fluxobs_adc_isr, IRQ_ZERO_LATENCY);
    irq_enable(ADC_IRQn);
}

/* For a thread: the interrupt may interrupt this function, but not the other way round. */
struct fluxobs_position fluxobs_zephyr_get(void)
{
    struct fluxobs_position copy;
    atomic_val_t read;
    do {
        read = atomic_get(&times);
        copy = shared;
    } while (atomic_get(&times) != read);
    return copy;
}
