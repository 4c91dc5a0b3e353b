/* fluxobs in a project of ST's motor control SDK: motor 1.
 *
 * In the generated mc_tasks.c call fluxobs_mcsdk_start() at the end of FOC_Clear, and
 *     fluxobs_mcsdk_run(&FOCVars[M1], VBS_GetAvBusVoltage_d(&(pBusSensorM1->_Super)));
 * in TSK_HighFrequencyTask after FOC_CurrControllerM1. Pass fluxobs_speed to STC_SetSpeedSensor
 * when fluxobs_mcsdk_run has returned true for some milliseconds.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 *
 * SPDX-License-Identifier: MIT
 */
#include <math.h>

#include "mcsdk_declarations.h" /* in the firmware: mc_type.h, speed_pos_fdbk.h, parameters_conversion.h */
#include "motor_observer.h"

void fluxobs_mcsdk_start(void);
bool fluxobs_mcsdk_run(const FOCVars_t *foc, uint16_t bus);

/* Time for which the angle is trusted after the last valid position [s]. */
#define PATIENCE 0.01f
/* Full scale of a current, 32768 [s16A], and of the bus voltage, 65536 [u16V]. */
#define AMPERES ((float)(ADC_REFERENCE_VOLTAGE / (2.0 * RSHUNT * AMPLIFICATION_GAIN)))
#define BUS_VOLTS ((float)(ADC_REFERENCE_VOLTAGE / VBUS_PARTITIONING_FACTOR))
/* Share of the control's period between a sample and the effect of its command. The ADC samples
 * when the counter is at its top. The timer loads new duties at its bottom, once in a control's
 * period. */
#define ACTS_AFTER (1.0f - 0.5f / (float)REGULATION_EXECUTION_RATE)
#define COUNTS_PER_RADIAN 10430.3784f

SpeednPosFdbk_Handle_t fluxobs_speed = {.bElToMecRatio = motor_pole_pairs};

static fo_state state;
static fo_estimate estimate;
static float last[2], before[2]; /* commands of the last interrupt and the one before, alpha and
                                  * beta [V] */
static float since_valid = 1e9f; /* [s] */

/* With the PWM off there are no interrupts. */
void fluxobs_mcsdk_start(void)
{
    fo_reset(&motor_observer, &state);
    last[0] = last[1] = before[0] = before[1] = NAN;
    since_valid = 1e9f;
}

/* Returns whether fluxobs_speed is reliable. */
bool fluxobs_mcsdk_run(const FOCVars_t *foc, uint16_t bus)
{
    /* ST's beta axis has the opposite direction. A command of 32768 is the bus voltage /
     * sqrt(3). */
    const float amperes = AMPERES / 32768.0f;
    const float volts = BUS_VOLTS * (float)bus / 65536.0f * 0.57735027f / 32768.0f;
    const float current[2] = {amperes * foc->Ialphabeta.alpha, -amperes * foc->Ialphabeta.beta};
    const float acting[2] = {ACTS_AFTER * before[0] + (1.0f - ACTS_AFTER) * last[0],
                             ACTS_AFTER * before[1] + (1.0f - ACTS_AFTER) * last[1]};
    before[0] = last[0];
    before[1] = last[1];
    last[0] = volts * foc->Valphabeta.alpha; /* command of this interrupt */
    last[1] = -volts * foc->Valphabeta.beta;

    fo_step(&motor_observer, &state, acting, current, &estimate);
    since_valid = estimate.valid ? 0.0f : since_valid + motor_observer.sample_time;

    /* The next interrupt uses this angle for a current that is one period newer. ST's angle is that
     * of the q axis: a quarter of a turn ahead of the magnet. */
    const float step = estimate.speed_e * motor_observer.sample_time;
    const float counts = COUNTS_PER_RADIAN * (estimate.theta_e_tracked + step) + 16384.0f;
    fluxobs_speed.hElAngle = (int16_t)(uint16_t)(int32_t)counts;
    fluxobs_speed.hElSpeedDpp = (int16_t)(COUNTS_PER_RADIAN * step);
    fluxobs_speed.InstantaneousElSpeedDpp = fluxobs_speed.hElSpeedDpp;
    fluxobs_speed.hAvrMecSpeedUnit =
        (int16_t)(estimate.speed_e * SPEED_UNIT / (6.28318531f * (float)motor_pole_pairs));
    return since_valid < PATIENCE;
}
