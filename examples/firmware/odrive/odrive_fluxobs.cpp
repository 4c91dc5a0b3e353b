/* fluxobs in the ODrive firmware: one axis.
 *
 * Add this first line to SensorlessEstimator::update() (sensorless_estimator.cpp):
 *     return fluxobs_update(*axis_);
 * The control loop runs in ControlLoop_IRQHandler: current_meas_cb has read the present current,
 * and pwm_update_cb will make the next command afterwards.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 *
 * SPDX-License-Identifier: MIT
 */
#include <cmath>

#include "motor_observer.h"
#include "odrive_declarations.hpp" /* in the firmware: odrive_main.h */

bool fluxobs_update(Axis &axis);

/* Time for which the angle is trusted after the last valid position [s]. */
static constexpr float PATIENCE = 0.01f;

static fo_state state;
static fo_estimate estimate;
static float next[2];            /* command two control loops ago, alpha and beta [V] */
static bool was_driven;          /* driven in the last control loop */
static float since_valid = 1e9f; /* [s] */

bool fluxobs_update(Axis &axis) {
    const Motor &motor = axis.motor_;
    const FieldOrientedController &foc = motor.current_control_;
    /* Other control laws, for calibration, do not state their voltage. */
    const bool driven = motor.is_armed_ && motor.control_law_ == &foc;
    const bool commanded = driven && was_driven; /* otherwise the motor sets the voltage: unknown */

    float current[2] = {NAN, NAN};
    if (motor.current_meas_.has_value()) {
        current[0] = motor.current_meas_->phA;
        current[1] = 0.57735027f * (motor.current_meas_->phB - motor.current_meas_->phC);
    }
    /* A command acts for one period, which begins one period after its sample. In the interval that
     * ends now, the command of the control loop before the last one acted. */
    const float acting[2] = {driven ? next[0] : NAN, driven ? next[1] : NAN};
    next[0] = commanded ? foc.final_v_alpha_ : NAN;
    next[1] = commanded ? foc.final_v_beta_ : NAN;
    was_driven = driven;

    fo_step(&motor_observer, &state, acting, current, &estimate);
    since_valid = estimate.valid ? 0.0f : since_valid + motor_observer.sample_time;
    if (since_valid > PATIENCE) {
        return true; /* the ports are empty: closed loop stops with ERROR_UNKNOWN_PHASE_ESTIMATE */
    }
    /* The phase belongs to the control loop's time stamp. Motor 0 is sampled earlier. */
    const float later = axis.axis_num_ == 0 ? (float)TIM1_INIT_COUNT / (float)TIM_1_8_CLOCK_HZ : 0.0f;
    axis.sensorless_estimator_.phase_ =
        std::remainder(estimate.theta_e_tracked + later * estimate.speed_e, 6.28318531f);
    axis.sensorless_estimator_.phase_vel_ = estimate.speed_e;
    axis.sensorless_estimator_.vel_estimate_ =
        estimate.speed_e / (6.28318531f * (float)motor.config_.pole_pairs);
    return true;
}
