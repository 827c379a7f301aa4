//! What a job demands of its workers, and when to give up on it: a job for a device that no worker has would wait for
//! ever, and look like one that waits its turn.
//!
//! A job is given up once workers are there, none of them has the device, and that has been so for a grace period. While
//! there is no worker at all it waits: nothing is known of those that will come.

use std::fmt;

use lightshaft_api::settings::{DeviceChoice, JobSettings};
use lightshaft_api::worker::{Device, DeviceKind};

use super::Millis;

/// The device that a task must have; none by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Demand {
    pub cpu: bool,
    pub gpu: bool,
    /// Part of the GPU's name, in lower case.
    pub adapter: Option<String>,
}

/// A worker that is there, and what it has.
#[derive(Clone, Debug, PartialEq)]
pub struct Offer {
    pub id: String,
    pub name: String,
    pub devices: Vec<Device>,
    /// It takes no task now, but may again.
    pub draining: bool,
}

impl Demand {
    pub fn of(settings: &JobSettings) -> Self {
        let gpu = settings.device() == DeviceChoice::Gpu;
        let adapter = settings.adapter().filter(|_| gpu).map(str::to_lowercase);
        Self { cpu: settings.device() == DeviceChoice::Cpu, gpu, adapter }
    }

    /// Whether every worker will do.
    pub fn is_any(&self) -> bool {
        !(self.cpu || self.gpu)
    }

    pub fn is_met_by(&self, devices: &[Device]) -> bool {
        let has = |kind| devices.iter().any(|device| device.kind == kind && self.names(device));
        (!self.cpu || has(DeviceKind::Cpu)) && (!self.gpu || has(DeviceKind::Gpu))
    }

    fn names(&self, device: &Device) -> bool {
        device.kind == DeviceKind::Cpu
            || self.adapter.as_ref().is_none_or(|part| device.name.to_lowercase().contains(part))
    }

    /// Why none of these workers can do it: what is demanded, and what they have. `None` when one can, and while none is
    /// there that takes tasks.
    pub fn unmet_by(&self, offers: &[Offer]) -> Option<String> {
        let nobody_works = offers.iter().all(|offer| offer.draining);
        if nobody_works || offers.iter().any(|offer| self.is_met_by(&offer.devices)) {
            return None;
        }
        Some(format!("the job demands {self}, and no worker has that: {}", Listed(offers)))
    }
}

impl fmt::Display for Demand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.adapter, self.gpu, self.cpu) {
            (Some(adapter), true, _) => write!(f, "a GPU with `{adapter}` in its name"),
            (None, true, _) => f.write_str("a GPU"),
            (_, false, true) => f.write_str("the CPU"),
            (_, false, false) => f.write_str("no device in particular"),
        }
    }
}

/// Workers with their devices, as many as a message can hold.
struct Listed<'a>(&'a [Offer]);

impl fmt::Display for Listed<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const SHOWN: usize = 5;
        for (i, offer) in self.0.iter().take(SHOWN).enumerate() {
            let devices: Vec<String> =
                offer.devices.iter().map(|device| format!("{} {}", device.kind.as_str(), device.name)).collect();
            let separator = if i == 0 { "" } else { "; " };
            write!(f, "{separator}`{}` has {}", offer.name, devices.join(" and "))?;
        }
        match self.0.len().saturating_sub(SHOWN) {
            0 => Ok(()),
            more => write!(f, "; and {more} more workers"),
        }
    }
}

/// Watches who is there, and since when it has been just these.
#[derive(Clone, Debug)]
pub struct Roll {
    offers: Vec<Offer>,
    since: Millis,
}

impl Roll {
    pub fn new(now: Millis) -> Self {
        Self { offers: Vec::new(), since: now }
    }

    /// Calls the roll; returns since when it has been the same.
    pub fn call(&mut self, offers: Vec<Offer>, now: Millis) -> Millis {
        if offers != self.offers {
            *self = Self { offers, since: now };
        }
        self.since
    }
}

/// Whether a task that could run from `ready_since` on, and that nobody on the roll can do, is given up now.
pub fn gives_up(ready_since: Millis, roll_since: Millis, grace: Millis, now: Millis) -> bool {
    now - ready_since.max(roll_since) >= grace
}

#[cfg(test)]
mod tests {
    use lightshaft_api::settings::RenderSettings;

    use super::*;

    fn offer(name: &str, devices: &[(DeviceKind, &str)]) -> Offer {
        let devices = devices.iter().map(|&(kind, name)| Device::named(kind, name)).collect();
        Offer { id: name.to_owned(), name: name.to_owned(), devices, draining: false }
    }

    fn demand(device: DeviceChoice, adapter: Option<&str>) -> Demand {
        let adapter = adapter.map(str::to_owned);
        Demand::of(&RenderSettings { device, adapter, ..RenderSettings::default() }.into())
    }

    const CPU: (DeviceKind, &str) = (DeviceKind::Cpu, "AVX2, 2 threads");
    const GPU: (DeviceKind, &str) = (DeviceKind::Gpu, "NVIDIA RTX 4090");

    #[test]
    fn a_demand_is_met_by_the_device_and_its_name() {
        let (cpu, gpu, both) = (offer("c", &[CPU]), offer("g", &[GPU]), offer("b", &[CPU, GPU]));
        for (demand, met) in [
            (demand(DeviceChoice::Auto, None), [true, true, true]),
            (demand(DeviceChoice::Auto, Some("rtx")), [true, true, true]),
            (demand(DeviceChoice::Cpu, None), [true, false, true]),
            (demand(DeviceChoice::Gpu, None), [false, true, true]),
            (demand(DeviceChoice::Gpu, Some("rtx 40")), [false, true, true]),
            (demand(DeviceChoice::Gpu, Some("Radeon")), [false, false, false]),
        ] {
            assert_eq!([&cpu, &gpu, &both].map(|offer| demand.is_met_by(&offer.devices)), met, "{demand:?}");
        }
    }

    #[test]
    fn the_reason_names_what_is_demanded_and_what_there_is() {
        let reason = demand(DeviceChoice::Gpu, Some("Radeon")).unmet_by(&[offer("a", &[CPU, GPU])]).unwrap();
        for part in ["GPU", "`radeon`", "`a`", "cpu AVX2, 2 threads", "gpu NVIDIA RTX 4090"] {
            assert!(reason.contains(part), "{part}: {reason}");
        }
        let many: Vec<Offer> = (0..9).map(|i| offer(&format!("w{i}"), &[CPU])).collect();
        assert!(demand(DeviceChoice::Gpu, None).unmet_by(&many).unwrap().ends_with("and 4 more workers"));
    }

    #[test]
    fn nothing_is_given_up_while_somebody_may_still_take_it() {
        let gpu_job = demand(DeviceChoice::Gpu, None);
        let drained = |offer: Offer| Offer { draining: true, ..offer };
        assert_eq!(gpu_job.unmet_by(&[]), None, "workers may join");
        assert_eq!(gpu_job.unmet_by(&[drained(offer("c", &[CPU]))]), None, "nobody works");
        assert_eq!(gpu_job.unmet_by(&[offer("c", &[CPU]), drained(offer("g", &[GPU]))]), None, "it may come back");
        assert!(gpu_job.unmet_by(&[offer("c", &[CPU])]).is_some());
    }

    #[test]
    fn the_grace_counts_from_the_last_change() {
        let mut roll = Roll::new(1_000);
        assert_eq!(roll.call(Vec::new(), 2_000), 1_000);
        assert_eq!(roll.call(vec![offer("c", &[CPU])], 3_000), 3_000);
        assert_eq!(roll.call(vec![offer("c", &[CPU])], 9_000), 3_000);
        assert_eq!(roll.call(vec![offer("c", &[CPU, GPU])], 9_500), 9_500, "it has a new device");
        assert!(!gives_up(0, 3_000, 10_000, 12_999));
        assert!(gives_up(0, 3_000, 10_000, 13_000));
        assert!(!gives_up(5_000, 3_000, 10_000, 13_000), "the job is younger than that");
    }
}
