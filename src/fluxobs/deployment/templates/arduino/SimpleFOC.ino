/* SimpleFOC without a position sensor: start in open loop, then close the loop on the flux observer.
 *
 * Adapt pins, limits and current sense to the board. Copy this sketch before you change it, so that
 * the library can be exported again.
 */
#include <SimpleFOC.h>

#include <FluxobsSensor.h>
#include <@prefix@_observer.h>

BLDCDriver3PWM driver = BLDCDriver3PWM(9, 5, 6, 8);
BLDCMotor motor = BLDCMotor(@prefix@_pole_pairs);
InlineCurrentSense sense = InlineCurrentSense(0.01f, 50.0f, A0, A2);
FluxobsSensor sensor = FluxobsSensor(@prefix@_observer, motor, sense);

const float SPEED = @try_speed@f; /* of the shaft [rad/s]: well above @slowest_shaft@, below which the position is lost */

void setup() {
    Serial.begin(115200);
    driver.voltage_power_supply = 24.0f; /* measured: it scales the voltages */
    driver.init();
    motor.linkDriver(&driver);
    sense.linkDriver(&driver);
    sense.init();
    motor.linkCurrentSense(&sense);
    motor.foc_modulation = FOCModulationType::SpaceVectorPWM; /* not trapezoidal: phases would float */
    motor.torque_controller = TorqueControlType::foc_current;
    motor.controller = MotionControlType::velocity_openloop;
    motor.current_limit = @rated@f; /* [A] */
    motor.init();
    motor.initFOC(); /* before the sensor is linked: there is nothing to align */
    sensor.init();
    motor.linkSensor(&sensor);
}

void loop() {
    static float speed = 0.0f;
    static uint32_t told = 0;
    speed = speed < SPEED ? speed + 0.002f * SPEED : SPEED; /* a ramp that the rotor can follow */
    motor.loopFOC();
    motor.move(speed);
    sensor.handOver(MotionControlType::velocity_openloop, MotionControlType::velocity);
    if (millis() - told > 500) {
        told = millis();
        Serial.print(sensor.estimate@position@.valid ? "valid, " : "not valid, ");
        Serial.print(sensor.getVelocity());
        Serial.print(" rad/s, standard deviation ");
        Serial.print(57.29578f * sensor.estimate@position@.theta_e_std);
        Serial.println(" degrees");
    }
}
