//! The flux observer of one machine: its position, speed and magnetic flux from biased currents and
//! voltages. It is the C source of the fluxobs library, in single precision, behind a safe interface:
//! no allocation, no panic, `no_std`. Content @content@.
//!
//! SI units; stationary frame, amplitude-invariant, per phase; current positive into the machine.
//! A step takes the mean voltage over the interval that **ends** now and the current now, @step_time@ s
//! after the last step. NaN is a missing sample.
//!
//! ```
//! let mut observer = @rust_crate@::Observer::new();
//! let estimate = observer.step([0.0, 0.0], [0.1, 0.0]);
//! assert!(!estimate.valid);
//! ```
#![no_std]

/// Time between steps [s].
pub const SAMPLE_TIME: f32 = @step_time@;
/// Pole pairs: the speed of the shaft is `speed_e` divided by this.
pub const POLE_PAIRS: u32 = @n_p@;

const OUTPUTS: usize = @outputs@;

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
@rust_fields@
}

impl Estimate {
    fn of(x: &[f32; OUTPUTS]) -> Self {
        Self {
@rust_values@
        }
    }

    /// Returns all fields as numbers, in their order.
    pub fn numbers(&self) -> [f32; OUTPUTS] {
        [
@rust_numbers@
        ]
    }
}

/// A known angle, from Hall sensors (`theta_e_std` 0.3 rad), an alignment or an encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// Electrical angle in (-pi, pi] [rad].
    pub theta_e: f32,
    /// Its standard deviation [rad].
    pub theta_e_std: f32,
    /// Electrical speed [rad/s].
    pub speed_e: f32,
    /// Magnet flux or active flux [Wb]; 0: the assumed flux.
    pub psi_f: f32,
    /// Its standard deviation [Wb]; 0: a quarter of the flux.
    pub psi_f_std: f32,
}

/// A Hall sector around zero; everything else is unknown.
impl Default for Seed {
    fn default() -> Self {
        Self { theta_e: 0.0, theta_e_std: 0.3, speed_e: 0.0, psi_f: 0.0, psi_f_std: 0.0 }
    }
}

/// State of the observer: plain data that can be copied and stored.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct State([u8; @state_bytes@]);

/// The observer of one motor.
#[derive(Clone, Copy)]
pub struct Observer {
    state: State,
}

extern "C" {
    fn fluxobs_@prefix@_reset(state: *mut State);
    fn fluxobs_@prefix@_seed(state: *mut State, seed: *const f32, current: *const f32);
    fn fluxobs_@prefix@_step(state: *mut State, u: *const f32, i: *const f32, out: *mut f32);
}

impl Default for Observer {
    fn default() -> Self {
        Self::new()
    }
}

impl Observer {
    /// Creates an observer with unknown position.
    pub fn new() -> Self {
        let mut observer = Self { state: State([0; @state_bytes@]) };
        observer.reset();
        observer
    }

    /// Starts over with unknown position; counters begin at 0.
    pub fn reset(&mut self) {
        // SAFETY: the state is large enough for C (csrc/door.c checks), aligned, and not shared.
        unsafe { fluxobs_@prefix@_reset(&mut self.state) }
    }

    /// Starts at a known angle and the present current [A]; `valid` follows under the usual conditions.
    pub fn seed(&mut self, at: &Seed, current: [f32; 2]) {
        let seed = [at.theta_e, at.theta_e_std, at.speed_e, at.psi_f, at.psi_f_std];
        // SAFETY: as in reset; C reads five and two numbers.
        unsafe { fluxobs_@prefix@_seed(&mut self.state, seed.as_ptr(), current.as_ptr()) }
    }

    /// Processes one sample: mean voltage over the interval that ends now [V], current now [A].
    pub fn step(&mut self, voltage: [f32; 2], current: [f32; 2]) -> Estimate {
        let mut out = [0.0; OUTPUTS];
        // SAFETY: as in reset; C reads two numbers each and writes OUTPUTS.
        unsafe {
            fluxobs_@prefix@_step(
                &mut self.state,
                voltage.as_ptr(),
                current.as_ptr(),
                out.as_mut_ptr(),
            )
        }
        Estimate::of(&out)
    }
}
