/* fluxobs in the moteus firmware.
 *
 * Add a member to BldcServo::Impl (fw/bldc_servo.cc):
 *     moteus::Fluxobs fluxobs_;
 * In ISR_CalculateCurrentState, before the call of ISR_CalculateDerivedQuantities, add:
 *     fluxobs_.Step(status_, control_);
 * The currents are then those of this interrupt, and control_ still holds the last command. In
 * ISR_CalculateDerivedQuantities (fw/bldc_servo_control.h) use fluxobs_.electrical_theta in place
 * of position_.electrical_theta while fluxobs_.theta_valid is true.
 *
 * For the adaptive observer use fo_adaptive_state, fo_adaptive_estimate, fo_adaptive_reset,
 * fo_adaptive_step, estimate.position in place of estimate, and motor_observer.plain.sample_time.
 *
 * SPDX-License-Identifier: MIT
 */
#pragma once
#include <math.h>

#include "motor_observer.h"
#include "moteus_declarations.h" /* in the firmware: fw/bldc_servo_structs.h */

/* Share of the period between a sample and the effect of its command. The timer loads new duties at
 * its top, where the ADC samples, and at its bottom. The duties are written late in the interrupt:
 * use 1 if servo_stats has final_timer > total_timer / 2, else 0.5. */
#ifndef FLUXOBS_ACTS_AFTER
#define FLUXOBS_ACTS_AFTER 1.0f
#endif

namespace moteus {

class Fluxobs {
public:
    void Step(const BldcServoStatus &status, const BldcServoControl_Control &control) {
        /* The third terminal is phase b of the model, as in the firmware's own transformation. */
        const fo_real current[FO_N] = {
            (2.0f * status.cur1_A - status.cur3_A - status.cur2_A) / 3.0f,
            (status.cur3_A - status.cur2_A) * 0.57735027f};
        /* A duty is never 0 while the bridge modulates. Brake is 0 V with the low sides on. In all
         * other states the motor sets the voltage: it is unknown. */
        const Vec3 &pwm = control.pwm;
        const bool driven = pwm.a > 0.0f || status.mode == kBrake;
        const float volts = driven ? status.filt_1ms_bus_V : NAN;
        const fo_real command[FO_N] = {(2.0f * pwm.a - pwm.b - pwm.c) * volts / 3.0f,
                                       (pwm.b - pwm.c) * volts * 0.57735027f};
        fo_real acting[FO_N];
        for (int n = 0; n < FO_N; n++) {
            acting[n] = FLUXOBS_ACTS_AFTER * before_[n] + (1.0f - FLUXOBS_ACTS_AFTER) * command[n];
            before_[n] = command[n];
        }
        fo_step(&motor_observer, &state, acting, current, &estimate);

        since_valid_ = estimate.valid ? 0.0f : since_valid_ + motor_observer.sample_time;
        theta_valid = since_valid_ < kPatience;
        const float turn = 6.28318531f, theta = estimate.theta_e_tracked;
        electrical_theta = theta < 0.0f ? theta + turn : theta;
        rotor_velocity = estimate.speed_e / (turn * (float)motor_pole_pairs);
    }

    bool theta_valid = false;
    float electrical_theta = 0.0f; /* angle of this sample, 0 to 2 pi [rad] */
    float rotor_velocity = 0.0f;   /* [turns/s]; times sign and rotor_to_output_ratio: speed of the
                                    * output */
    fo_estimate estimate = {};
    fo_state state = {};

private:
    /* Time for which the angle is trusted after the last valid position [s]. */
    static constexpr float kPatience = 0.01f;

    fo_real before_[FO_N] = {NAN, NAN}; /* command two interrupts ago [V] */
    float since_valid_ = 1e9f;          /* [s] */
};

}
