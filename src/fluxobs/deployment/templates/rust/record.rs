//! Replays the record of this export: every output equals the library's in single precision.
use @rust_crate@::{Observer, Seed};

#[test]
fn every_output_is_the_librarys() {
    let text = include_str!("record.csv");
    let mut observer = Observer::new();
    let (mut rows, mut valid) = (0, 0);
    for line in text.lines().skip(1) {
        let row: Vec<f32> = line
            .split(',')
            .map(|cell| cell.parse::<f64>().expect("a number") as f32)
            .collect();
        let found = observer.step([row[0], row[1]], [row[2], row[3]]);
        for (n, (is, right)) in found.numbers().iter().zip(&row[4..]).enumerate() {
            assert_eq!(is.to_bits(), right.to_bits(), "row {rows}, output {n}: {is} for {right}");
        }
        rows += 1;
        valid += usize::from(found.valid);
    }
    assert!(rows > 1000 && valid > 0);
}

#[test]
fn a_seed_is_carried_on() {
    let mut observer = Observer::new();
    let at = Seed { theta_e: 1.0, theta_e_std: 0.05, ..Seed::default() };
    observer.seed(&at, [0.0, 0.0]);
    let found = observer.step([0.0, 0.0], [0.0, 0.0]);
    assert!((found.theta_e - 1.0).abs() < 0.01 && !found.valid);
}
