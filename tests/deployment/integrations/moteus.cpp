/* Plays the moteus firmware: its interrupt around the shim. */
#include "motor.h"

#include "moteus_fluxobs.h"

int main(int argc, char **argv) {
    moteus::Fluxobs fluxobs;
    moteus::BldcServoStatus status;
    moteus::BldcServoControl_Control control;
    double u[2] = {0.0, 0.0}, old[2] = {0.0, 0.0}, abc[3], duty[3];
    motor_start(argc, argv, 1.0 / 30000.0);
    while (!motor_done()) {
        const bool on = motor_gates();
        motor_currents(abc);
        status.cur1_A = (float)abc[0];
        status.cur3_A = (float)abc[1];
        status.cur2_A = (float)abc[2];
        status.filt_1ms_bus_V = (float)BUS;
        status.mode = on ? moteus::kCurrent : moteus::kStopped;
        fluxobs.Step(status, control);
        motor_judge(fluxobs.theta_valid, fluxobs.electrical_theta,
                    TURN * motor_pole_pairs * (double)fluxobs.rotor_velocity, 0.0);
        motor_command(0.5 + FLUXOBS_ACTS_AFTER, u);
        motor_duties(u, duty);
        control.pwm = moteus::Vec3();
        if (on) {
            control.pwm.a = (float)duty[0];
            control.pwm.b = (float)duty[1];
            control.pwm.c = (float)duty[2];
        }
        motor_voltage(duty, u);
        motor_half(old);
        motor_half(FLUXOBS_ACTS_AFTER < 1.0f ? u : old);
        memcpy(old, u, sizeof u);
    }
    motor_report();
    return 0;
}
