/* A simulated servo motor and its current control, for the harnesses that simulate a host's
 * firmware.
 *
 * The rotor follows a prescribed run-up to `turns` rad/s. The gates are off, then on, off and on
 * again. At each sample a harness reads the currents, calls the shim as the firmware would, asks
 * for the next command, and runs the motor with the voltages that the host's PWM applies for the
 * commands.
 *
 * A test can inject a fault, to check that the fault is detected:
 *     later     every voltage acts half a period later than in the host
 *     reversed  the current is measured with the opposite sign
 *     swapped   phases b and c are swapped in the currents
 */
#ifndef MOTOR_H
#define MOTOR_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double MOTOR_R = 0.36, MOTOR_L = 0.6e-3, MOTOR_PSI = 0.0125, BUS = 90.0;
static const double TURN = 6.283185307179586;

static struct {
    double period, full_speed;          /* [s], electrical [rad/s] */
    double time, theta, speed;          /* [s], [rad], [rad/s] */
    double i[2];                        /* true, alpha and beta [A] */
    double late[2][2];                  /* voltages that a fault delays */
    double integral[2];                 /* of the current control, dq [V] */
    const char *fault;
    double worst, worst_speed;          /* errors while trusted [rad], [rad/s] */
    double off[2], settled;             /* sums over the end of the run */
    long trusted, wrong_off, ends;
} motor;

static inline bool motor_gates(void)
{
    const double now = motor.period * floor(motor.time / motor.period + 1e-3); /* this sample */
    return (now > 0.03 && now < 0.25) || now > 0.29;
}

static inline bool motor_done(void)
{
    return motor.time > 0.5;
}

static inline void motor_start(int argc, char **argv, double period)
{
    motor.period = period;
    /* In half a period, the rotor turns by 2.3 degrees. */
    motor.full_speed = (argc > 1 ? atof(argv[1]) : 1.0) * 0.08 / period;
    motor.fault = argc > 2 ? argv[2] : "";
    motor.theta = 0.5;
    motor.speed = 0.5 * motor.full_speed;
}

/* Returns the measured currents of phases a, b, c, with offsets [A]. */
static inline void motor_currents(double abc[3])
{
    const double sign = strcmp(motor.fault, "reversed") == 0 ? -1.0 : 1.0;
    const double a = motor.i[0], half = 0.5 * a, b = 0.8660254037844386 * motor.i[1];
    const bool swapped = strcmp(motor.fault, "swapped") == 0;
    const double two[2] = {b - half, -b - half};
    abc[0] = sign * a + 0.03;
    abc[1] = sign * two[swapped ? 1 : 0] - 0.02;
    abc[2] = sign * two[swapped ? 0 : 1] - 0.01;
}

static inline void motor_current(double i[2])
{
    double abc[3];
    motor_currents(abc);
    i[0] = (2.0 * abc[0] - abc[1] - abc[2]) / 3.0;
    i[1] = (abc[1] - abc[2]) / sqrt(3.0);
}

/* Computes the next command, alpha and beta [V], which acts `centre` periods from now on average. */
static inline void motor_command(double centre, double u[2])
{
    const double c = cos(motor.theta), s = sin(motor.theta), w = motor.speed;
    const double i_d = c * motor.i[0] + s * motor.i[1], i_q = c * motor.i[1] - s * motor.i[0];
    const double ahead = motor.theta + centre * motor.period * w;
    const double error[2] = {0.0 - i_d, 5.0 - i_q}, band = 0.1 / motor.period;
    double v[2];
    if (!motor_gates()) {
        motor.integral[0] = motor.integral[1] = 0.0;
    }
    for (int n = 0; n < 2; n++) {
        motor.integral[n] += band * MOTOR_R * motor.period * error[n];
        v[n] = band * MOTOR_L * error[n] + motor.integral[n];
    }
    v[0] -= w * MOTOR_L * i_q;
    v[1] += w * (MOTOR_L * i_d + MOTOR_PSI);
    u[0] = cos(ahead) * v[0] - sin(ahead) * v[1];
    u[1] = sin(ahead) * v[0] + cos(ahead) * v[1];
}

/* Duties of a command, 0 to 1, by space-vector modulation; motor_voltage is the inverse. */
static inline void motor_duties(const double u[2], double duty[3])
{
    const double v[3] = {u[0], -0.5 * u[0] + 0.8660254037844386 * u[1],
                         -0.5 * u[0] - 0.8660254037844386 * u[1]};
    const double middle = 0.5 * (fmax(v[0], fmax(v[1], v[2])) + fmin(v[0], fmin(v[1], v[2])));
    for (int n = 0; n < 3; n++) {
        duty[n] = 0.5 + (v[n] - middle) / BUS;
    }
}

static inline void motor_voltage(const double duty[3], double u[2])
{
    u[0] = BUS * (2.0 * duty[0] - duty[1] - duty[2]) / 3.0;
    u[1] = BUS * (duty[1] - duty[2]) / sqrt(3.0);
}

/* Runs the motor for half a period with this voltage, or without current if the gates are off. */
static inline void motor_half(const double wanted[2])
{
    const int parts = 40;
    const double h = 0.5 * motor.period / parts;
    double u[2] = {wanted[0], wanted[1]};
    if (strcmp(motor.fault, "later") == 0) {
        memcpy(u, motor.late[0], sizeof u);
        memcpy(motor.late[0], wanted, sizeof u);
    }
    for (int n = 0; n < parts; n++) {
        const double goal = motor.time < 0.08 ? 0.5 * motor.full_speed : motor.full_speed;
        const double middle = motor.theta + 0.5 * h * motor.speed;
        const double emf[2] = {-motor.speed * MOTOR_PSI * sin(middle),
                               motor.speed * MOTOR_PSI * cos(middle)};
        for (int m = 0; m < 2; m++) {
            motor.i[m] = motor_gates()
                             ? motor.i[m] + h / MOTOR_L * (u[m] - MOTOR_R * motor.i[m] - emf[m])
                             : 0.0;
        }
        motor.theta += h * motor.speed;
        motor.speed += h / 0.05 * (goal - motor.speed);
        motor.time += h;
    }
}

/* Compares the host's electrical angle [rad] and speed [rad/s] with the true values; the host
 * predicts the angle `ahead` seconds from now. `trusted` says whether the host uses them. */
static inline void motor_judge(bool trusted, double theta, double speed, double ahead)
{
    static double off_since;
    const double off = remainder(theta - motor.theta - ahead * motor.speed, TURN);
    if (motor_gates()) {
        off_since = motor.time;
    }
    /* The host may trust the angle for 10 ms after the gates were switched off. */
    if (trusted && motor.time - off_since > 0.011) {
        motor.wrong_off++;
    }
    if (trusted && motor_gates()) {
        motor.trusted++;
        motor.worst = fmax(motor.worst, fabs(off));
    }
    if (motor.time > 0.45) {
        motor.ends++;
        motor.settled += trusted ? 1.0 : 0.0;
        motor.off[0] += off;
        motor.off[1] += off * off;
        motor.worst_speed = fmax(motor.worst_speed, fabs(speed - motor.speed));
    }
}

static inline void motor_report(void)
{
    printf("trusted %g worst %g mean %g rms %g speed %g off %ld\n", motor.settled / motor.ends,
           360.0 / TURN * motor.worst, 360.0 / TURN * motor.off[0] / motor.ends,
           360.0 / TURN * sqrt(motor.off[1] / motor.ends), motor.worst_speed / fabs(motor.full_speed),
           motor.wrong_off);
}

#endif
