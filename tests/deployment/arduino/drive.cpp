/* A simulated servo motor with the exported sensor: starts in open loop, hands over, then the gates
 * are switched off. Prints the events; the period of the loop varies. */
#include "SimpleFOC.h"

#include "FluxobsSensor.h"
#include "motor_observer.h"

uint32_t now_us = 0;
SerialPort Serial;

static double R = 0.36, L = 0.6e-3, psi = 0.0125, inertia = 2e-5, friction = 2e-5;
static double i_alpha = 0.0, i_beta = 0.0, theta = 0.5, omega = 0.0; /* electrical */

class Currents : public CurrentSense {
public:
    PhaseCurrent_s getPhaseCurrents() override { /* with an offset */
        const double b = -0.5 * i_alpha + 0.8660254 * i_beta;
        return {(float)i_alpha + 0.05f, (float)b - 0.03f, (float)(-i_alpha - b)};
    }
};

static void run_for(const FOCMotor &motor, double duration) {
    const double h = 1e-6;
    for (double t = 0.0; t < duration - h / 2; t += h) {
        const double e_alpha = -omega * psi * std::sin(theta), e_beta = omega * psi * std::cos(theta);
        if (motor.enabled) {
            i_alpha += h / L * (motor.Ualpha - R * i_alpha - e_alpha);
            i_beta += h / L * (motor.Ubeta - R * i_beta - e_beta);
        } else {
            i_alpha = i_beta = 0.0;
        }
        const double i_q = i_beta * std::cos(theta) - i_alpha * std::sin(theta);
        const double p = motor.pole_pairs;
        omega += h * p / inertia * (1.5 * p * psi * i_q - friction * omega);
        theta += h * omega;
    }
}

int main() {
    BLDCMotor motor(motor_pole_pairs);
    Currents currents;
    FluxobsSensor sensor(motor_observer, motor, currents);
    motor.controller = MotionControlType::velocity_openloop;
    motor.enabled = 1;
    sensor.init();
    unsigned seed = 1, loops = 0, closed = 0;
    double worst = 0.0, angle = 0.0, speed = 0.0, handed_over = 0.0, lost = 0.0, t = 0.0;
    while (t < 2.0) {
        seed = seed * 1103515245u + 12345u;
        const uint32_t us = 80 + (seed >> 16) % 80;
        run_for(motor, 1e-6 * us);
        now_us += us;
        t += 1e-6 * us;
        sensor.update();
        if (sensor.needsSearch() == 0) {
            const double error = std::remainder(
                motor.pole_pairs * (double)sensor.getMechanicalAngle() - theta, 6.283185307179586);
            worst = std::fabs(error) > worst ? std::fabs(error) : worst;
        }
        motor.enabled = t < 1.8;
        double set = 0.0, volts = 0.0;
        if (motor.controller == MotionControlType::velocity_openloop) {
            speed = speed < 400.0 ? speed + 400.0 * 1e-6 * us / 0.5 : 400.0;
            angle += 1e-6 * us * speed;
            set = angle;
            volts = 1.0 + speed * psi;
        } else {
            closed++;
            set = motor.pole_pairs * (double)sensor.getMechanicalAngle();
            volts = 6.0;
        }
        motor.Ualpha = (float)(-volts * std::sin(set));
        motor.Ubeta = (float)(volts * std::cos(set));
        const MotionControlType before = motor.controller;
        sensor.handOver(MotionControlType::velocity_openloop, MotionControlType::velocity);
        if (motor.controller != before) {
            (before == MotionControlType::velocity_openloop ? handed_over : lost) = t;
        }
        loops++;
    }
    std::printf("handed over %g lost %g closed %g worst %g speed %g true %g turns %g\n", handed_over,
                lost, (double)closed / loops, worst, (double)sensor.getVelocity(),
                omega / motor.pole_pairs, sensor.getAngle() / 6.283185307179586);
    return 0;
}
