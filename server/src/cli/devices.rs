//! `lightshaft devices`

use lightshaft_api::settings::DeviceChoice;
use lightshaft_worker::executor::Devices;

use super::error::Result;
use super::{Global, output};

pub(crate) fn run(global: &Global) -> Result<()> {
    let devices = Devices::new(DeviceChoice::Auto).list();
    if global.json {
        return output::print_json(&devices);
    }
    let mut table = output::Table::new(&["kind", "name", "backend", "type", "driver"]);
    for device in devices {
        table.row([device.kind.as_str().to_owned(), device.name, device.backend, device.device_type, device.driver]);
    }
    table.print()
}
