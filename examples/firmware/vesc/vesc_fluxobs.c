/* fluxobs in the VESC firmware: one motor.
 *
 * Call fluxobs_vesc_run(motor_now) at two places of mcpwm_foc_adc_int_handler (motor/mcpwm_foc.c):
 * one where the motor runs, one where it does not run. Both places are after foc_observer_update
 * and the line that adds pll_speed * dt to the observer's phase. The current is then that of this
 * interrupt, and the modulation is still the command of the last interrupt.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 * The adaptive observer learns the inverter's loss: give it mod_alpha_raw and mod_beta_raw.
 *
 * SPDX-License-Identifier: MIT
 */
#include <math.h>

#include "motor_observer.h"
#include "vesc_declarations.h" /* in the firmware: foc_math.h */

bool fluxobs_vesc_run(motor_all_state_t *motor);

/* Time for which the angle is trusted after the last valid position [s]. */
#define PATIENCE 0.01f

static fo_state state;
static fo_estimate estimate;
static float before[2];          /* command two interrupts ago, alpha and beta [V] */
static bool was_running;         /* running in the last interrupt */
static float since_valid = 1e9f; /* [s] */

/* Returns whether fluxobs has set the phase of the motor. */
bool fluxobs_vesc_run(motor_all_state_t *motor)
{
    const motor_state_t *const now = &motor->m_motor_state;
    const bool running = motor->m_state == MC_STATE_RUNNING;
    const bool commanded = running && was_running; /* otherwise the motor sets the voltage:
                                                    * unknown */
    const float volts = 2.0f / 3.0f * now->v_bus;
    const float command[2] = {commanded ? now->mod_alpha_measured * volts : NAN,
                              commanded ? now->mod_beta_measured * volts : NAN};
    const float current[2] = {now->i_alpha, now->i_beta};
    float acting[2];

    /* The timer loads new duties at its top and at its bottom. V0 samples only at the top: a
     * command acts half a period after its sample. V0_V7 samples every half period: a command acts
     * from the next sample on. */
#ifdef HW_HAS_PHASE_SHUNTS
    if (motor->m_conf->foc_control_sample_mode == FOC_CONTROL_SAMPLE_MODE_V0_V7) {
        acting[0] = before[0];
        acting[1] = before[1];
    } else
#endif
    {
        acting[0] = 0.5f * (before[0] + command[0]);
        acting[1] = 0.5f * (before[1] + command[1]);
    }
    if (motor->m_conf->foc_control_sample_mode == FOC_CONTROL_SAMPLE_MODE_V0_V7_INTERPOL) {
        acting[0] = acting[1] = NAN; /* this mode turns the command in between: not supported */
    }
    before[0] = command[0];
    before[1] = command[1];
    was_running = running;

    fo_step(&motor_observer, &state, acting, current, &estimate);
    since_valid = estimate.valid ? 0.0f : since_valid + motor_observer.sample_time;
    if (since_valid > PATIENCE) {
        return false; /* VESC's own observer continues */
    }
    motor->m_phase_now_observer = estimate.theta_e_tracked;
    motor->m_pll_phase = estimate.theta_e_tracked;
    motor->m_pll_speed = estimate.speed_e;
    return true;
}
