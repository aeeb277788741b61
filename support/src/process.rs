//! What the operating system knows of this process, under the names that Prometheus' own clients use.

use std::fmt::Write as _;
use std::time::{SystemTime, UNIX_EPOCH};

/// The `process_*` metrics in Prometheus' text format; what cannot be read is left out.
#[must_use]
pub(crate) fn metrics() -> String {
    let read = |file: &str| std::fs::read_to_string(format!("/proc/self/{file}")).unwrap_or_default();
    let open_files = std::fs::read_dir("/proc/self/fd").map(Iterator::count).ok();
    let uptime = std::fs::read_to_string("/proc/uptime").unwrap_or_default();
    let system = System {
        ticks: rustix::param::clock_ticks_per_second() as f64,
        page: rustix::param::page_size() as f64,
        now: SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64(),
        uptime: uptime.split(' ').next().and_then(|text| text.parse().ok()),
    };
    render(&read("stat"), &read("limits"), open_files, &system)
}

/// What the numbers of `/proc` are measured in.
struct System {
    /// Clock ticks a second.
    ticks: f64,
    /// Bytes of a page.
    page: f64,
    /// Seconds since 1970.
    now: f64,
    /// Seconds since the machine started, by the same clock as processes' start times.
    uptime: Option<f64>,
}

fn render(stat: &str, limits: &str, open_files: Option<usize>, system: &System) -> String {
    // The program's name, in parentheses, may hold anything; the third field follows it. Numbered as in proc(5).
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let field = |number: usize| fields.get(number - 3).and_then(|text| text.parse::<f64>().ok());
    let cpu = field(14).zip(field(15)).map(|(user, kernel)| (user + kernel) / system.ticks);
    let started = field(22).zip(system.uptime).map(|(ticks, up)| system.now - up + ticks / system.ticks);
    let most_files = limits.lines().find_map(|line| line.strip_prefix("Max open files"));
    let most_files = most_files.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
    let rows = [
        ("process_cpu_seconds_total", "counter", "CPU time of the process, user and system, seconds", cpu),
        (
            "process_resident_memory_bytes",
            "gauge",
            "Memory of the process in RAM",
            field(24).map(|pages| pages * system.page),
        ),
        ("process_virtual_memory_bytes", "gauge", "Address space of the process", field(23)),
        ("process_threads", "gauge", "Threads of the process", field(20)),
        ("process_open_fds", "gauge", "Open file descriptors", open_files.map(|count| count as f64)),
        ("process_max_fds", "gauge", "Most file descriptors that may be open", most_files),
        ("process_start_time_seconds", "gauge", "Start of the process, seconds since 1970", started),
    ];
    let mut text = String::new();
    for (name, kind, help, value) in rows {
        if let Some(value) = value {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}\n{name} {value}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str, name: &str) -> f64 {
        let line = text.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap_or(text);
        line.rsplit(' ').next().unwrap().parse().unwrap()
    }

    #[test]
    fn a_program_s_name_does_not_shift_the_numbers() {
        let numbers: Vec<String> = (4..=52).map(|number| (number * 100).to_string()).collect();
        let stat = format!("7 (a) b ( c) R {}", numbers.join(" "));
        let limits =
            "Limit  Soft Limit  Hard Limit\nMax open files            1024                 4096    files\n";
        let system = System { ticks: 100.0, page: 4096.0, now: 1000.0, uptime: Some(50.0) };
        let text = render(&stat, limits, Some(9), &system);
        assert_eq!(value(&text, "process_cpu_seconds_total"), 29.0);
        assert_eq!(value(&text, "process_resident_memory_bytes"), 2400.0 * 4096.0);
        assert_eq!(value(&text, "process_virtual_memory_bytes"), 2300.0);
        assert_eq!(value(&text, "process_threads"), 2000.0);
        assert_eq!(value(&text, "process_open_fds"), 9.0);
        assert_eq!(value(&text, "process_max_fds"), 1024.0);
        assert_eq!(value(&text, "process_start_time_seconds"), 972.0);
    }

    #[test]
    fn what_is_not_there_is_left_out() {
        let system = System { ticks: 100.0, page: 4096.0, now: 1000.0, uptime: None };
        assert_eq!(render("", "", None, &system), "");
    }

    #[test]
    fn this_process_has_memory_threads_and_files() {
        let text = metrics();
        assert!(value(&text, "process_resident_memory_bytes") > 100_000.0, "{text}");
        assert!(value(&text, "process_threads") >= 1.0 && value(&text, "process_open_fds") >= 1.0, "{text}");
        let age = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
            - value(&text, "process_start_time_seconds");
        assert!((-2.0..86_400.0).contains(&age), "{age}");
    }
}
