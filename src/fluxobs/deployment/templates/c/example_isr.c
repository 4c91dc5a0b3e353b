@every interrupt@
/* Example: calls the observer once per interrupt of the current control, every @sample_time@ s.
@every few@
/* Example for an observer that steps only every few interrupts: the current control interrupts
 * every @sample_time@ s, the observer takes a step every @step_time@ s, and volt-seconds are summed
 * in between.
@always@
 * Copy this file under another name before you change it, so that the folder can be exported again.
 * You must write the functions that are declared here.
 *
 *      t[k-1]               t[k]                 t[k+1]
 *        |  `acting` acts    |  `next` acts       |  the command of now acts
 *      interrupt           interrupt: i[k] sampled
 */
#include <math.h>

#include "@prefix@_observer.h"

void drive_read_currents(float i_abc[3]); /* [A], positive into the machine */
float drive_read_dc_link(void);           /* [V] */
bool drive_gates_are_on(void);
void drive_current_control(const float i[2], float theta_e, float speed_e, bool position_known,
                           float udc, float command[2]);
void drive_write_voltage(const float command[2], float udc);
void drive_start(void);
void current_control_interrupt(void);

static @fo@_state state;
static @fo@_estimate estimate;
@every few@
static fo_gathered gathered;
static int since_step; /* interrupts since the observer's last step */
@always@
static float acting[2]; /* mean voltage, alpha and beta [V], over the interval that ends now */
static float next[2];   /* over the interval that begins now; commanded one interrupt ago */

/* Call this each time before the gates are switched on: with the gates off the voltage is unknown. */
void drive_start(void)
{
@when plain@
    static const fo_estimate nothing_known = {{0.0f, 0.0f}, 0.0f, 0.0f, 0.0f, 0.0f, {0.0f, 0.0f},
                                              0.0f, 0.0f, 0.0f, false, FO_NO_DATA};
@when adaptive@
    static const fo_adaptive_estimate nothing_known = {
        {{0.0f, 0.0f}, 0.0f, 0.0f, 0.0f, 0.0f, {0.0f, 0.0f}, 0.0f, 0.0f, 0.0f, false, FO_NO_DATA},
        0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, false};
@always@
@every few@
    static const fo_gathered nothing = {{0.0f, 0.0f}, {0.0f, 0.0f}};
    gathered = nothing;
    since_step = 0;
@always@
    @fo@_reset(&@prefix@_observer, &state);
    estimate = nothing_known;
    acting[0] = acting[1] = NAN; /* unknown: no voltage has been commanded yet */
    next[0] = next[1] = NAN;
}

void current_control_interrupt(void)
{
@every few@
    const float share = 1.0f / (float)@prefix@_update_every;
@always@
    float i_abc[3], i[2], command[2];
    const float udc = drive_read_dc_link();
    drive_read_currents(i_abc);

    /* Clarke's transform, amplitude-invariant; with two sensors i_c = -i_a - i_b. */
    i[0] = (2.0f * i_abc[0] - i_abc[1] - i_abc[2]) / 3.0f;
    i[1] = (i_abc[1] - i_abc[2]) * 0.57735027f;

@every interrupt@
    @fo@_step(&@prefix@_observer, &state, acting, i, &estimate);
@every few@
    fo_gather(&@prefix@_observer@plain@, &gathered, share, acting, i);
    since_step++;
    if (since_step == @prefix@_update_every) {
        @fo@_step_volt_seconds(&@prefix@_observer, &state, gathered.volt_seconds, i, &estimate);
        gathered.volt_seconds[0] = gathered.volt_seconds[1] = 0.0f;
        since_step = 0;
    }
@always@

@every interrupt@
    /* The angle [rad] and speed [rad/s], electrical, are those of t[k]. `valid` says whether the
@every few@
    /* Between steps the angle is extrapolated at the speed; wrap the angle if your control needs
     * this. Angle [rad] and speed [rad/s], electrical, are those of t[k]. `valid` says whether the
@always@
     * position is known. If the position has been unknown for long, do not use it for commutation
     * (README, "When the position is valid", says how long and what to do). The command will act
     * around t[k] + 1.5 periods: turn the command ahead by 1.5 * @sample_time@ * speed_e. */
@every interrupt@
    drive_current_control(i, estimate@position@.theta_e_tracked, estimate@position@.speed_e, estimate@position@.valid, udc, command);
@every few@
    const float ahead = (float)since_step * share * @prefix@_observer@plain@.sample_time;
    drive_current_control(i, estimate@position@.theta_e_tracked + estimate@position@.speed_e * ahead, estimate@position@.speed_e,
                          estimate@position@.valid, udc, command);
@always@

    /* If the modulator limits the voltage, `command` must hold the applied voltage, not the desired
     * voltage: limit `command` to the hexagon of udc before you write it. */
    drive_write_voltage(command, udc);
    if (!drive_gates_are_on()) {
        command[0] = command[1] = NAN; /* unknown: the machine determines the voltage */
    }

    /* The PWM applies the new duties at t[k+1], one interrupt from now (a log of such a drive has
     * lag -1). If the PWM applies the duties at once, `next` is not needed: acting = command (lag
     * 0). If the PWM applies the duties in between, weight both voltages by the time for which they
     * act. */
    acting[0] = next[0];
    acting[1] = next[1];
    next[0] = command[0];
    next[1] = command[1];
}
