//! Steady traffic allocates nothing: neither a step, nor walking over all its values, nor setting all lights.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]

mod common;

use cross_traci::constants::vehicle;
use cross_traci::{Domain, Sumo};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// Counts what this thread allocates; SUMO's output is read on others.
struct Counting;

#[expect(unsafe_code, reason = "an allocator can only be written so")]
// SAFETY: every call is passed on unchanged to the system's allocator, which keeps the trait's contract. The counter is
// a thread-local integer without destructor, so that using it neither allocates nor fails at a thread's end.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller keeps the contract of `alloc`, which is the same here.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the pointer comes from `alloc` above, that is from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// Ten seconds of traffic: all lights set, a step, and every value looked at. Gives the number of values.
fn decision(sumo: &mut Sumo, lights: &[String], state: &str, time: f64) -> usize {
    let mut batch = sumo.client().batch();
    for light in lights {
        batch.set_traffic_light_state(light, state);
    }
    batch.send().unwrap();
    let results = sumo.client().simulation_step(time).unwrap();
    let mut values = 0;
    for object in results.iter().flat_map(|subscription| subscription.objects()) {
        assert!(!object.id().is_empty());
        for (_, value) in object.values() {
            values += usize::from(value.str().is_ok() || value.double().is_ok());
        }
    }
    values
}

#[test]
fn a_step_and_all_its_values_cost_no_allocation() {
    let mut sumo = common::start();
    let lights = sumo.client().ids(Domain::TrafficLight).unwrap();
    let wanted = [vehicle::LANE_ID, vehicle::LANE_POSITION, vehicle::SPEED];
    sumo.client().subscribe_context(Domain::Junction, "A0", 1e7, Domain::Vehicle, &wanted).unwrap();
    let (green, red) = ("G".repeat(36), "r".repeat(36));
    // The first steps fill the buffers.
    for step in 1..=30 {
        decision(&mut sumo, &lights, if step % 2 == 0 { &green } else { &red }, 10.0 * f64::from(step));
    }
    let before = ALLOCATIONS.get();
    let mut values = 0;
    for step in 31..=40 {
        values +=
            decision(&mut sumo, &lights, if step % 2 == 0 { &green } else { &red }, 10.0 * f64::from(step));
    }
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(values > 500, "{values} values");
}
