/* fluxobs in MESC: one motor. MESC has its own observer MESCfluxobs; the names here differ from it.
 *
 * Call fluxobs_mesc_written(_motor) as the last line of MESCpwm_Write (MESC_Common/Src/MESCpwm.c).
 * Call fluxobs_mesc_run(_motor) in fastLoop (MESCfoc.c), MOTOR_STATE_RUN,
 * MOTOR_SENSOR_MODE_SENSORLESS, between MESCfluxobs_run and MESCFOC.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 *
 * SPDX-License-Identifier: MIT
 */
#include <math.h>

#include "mesc_declarations.h" /* in the firmware: MESCfoc.h */
#include "motor_observer.h"

void fluxobs_mesc_written(const MESC_motor_typedef *motor);
bool fluxobs_mesc_run(MESC_motor_typedef *motor);

/* Time for which the angle is trusted after the last valid position [s]. */
#define PATIENCE 0.01f
#define COUNTS_PER_RADIAN 10430.3784f

static fo_state state;
static fo_estimate estimate;
static float written[4][2];      /* last voltages, newest first, alpha and beta [V] */
static bool stopped = true;      /* the motor was off at one of these voltages */
static float since_valid = 1e9f; /* [s] */

void fluxobs_mesc_written(const MESC_motor_typedef *motor)
{
    const bool runs = motor->MotorState == MOTOR_STATE_RUN;
    for (int age = 3; age > 0; age--) {
        written[age][0] = written[age - 1][0];
        written[age][1] = written[age - 1][1];
    }
    written[0][0] = runs ? motor->FOC.Vab.a : NAN; /* unknown: the motor sets the voltage */
    written[0][1] = runs ? motor->FOC.Vab.b : NAN;
    stopped = stopped || !runs;
}

/* Returns whether fluxobs has set the angle. */
bool fluxobs_mesc_run(MESC_motor_typedef *motor)
{
    const float current[2] = {motor->FOC.Iab.a, motor->FOC.Iab.b};
    /* Duties are written at the counter's top and bottom. Duties act half a period later, for half
     * a period. The last write was at this top. In the interval that ends now, the duties written
     * at the bottom before the last top acted first, and then those written at that top. */
    const float acting[2] = {0.5f * (written[3][0] + written[2][0]),
                             0.5f * (written[3][1] + written[2][1])};
    if (stopped) {
        fo_reset(&motor_observer, &state); /* there were interrupts without a step */
        since_valid = 1e9f;
        stopped = false;
    }
    fo_step(&motor_observer, &state, acting, current, &estimate);
    since_valid = estimate.valid ? 0.0f : since_valid + motor_observer.sample_time;
    if (since_valid > PATIENCE || motor->HFI.inject != 0) {
        return false; /* MESC's own angle is used */
    }
    motor->FOC.FOCAngle = (uint16_t)(int32_t)(estimate.theta_e_tracked * COUNTS_PER_RADIAN);
    motor->FOC.PLL_int = estimate.speed_e * motor->FOC.pwm_period * COUNTS_PER_RADIAN;
    return true;
}
