//! ethercrab brings the slaves at an interface to OP and runs cycles; prints one line of JSON.
//! With a period (ms) as third argument SYNC0 is on, as its example `dc` has it.

use ethercrab::{
    std::ethercat_now, subdevice_group::DcConfiguration, DcSync, MainDevice, MainDeviceConfig,
    PduStorage, Timeouts,
};
use std::{
    env,
    time::{Duration, Instant},
};

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

fn main() {
    let mut arguments = env::args().skip(1);
    let interface = arguments.next().expect("usage: reach-op INTERFACE [CYCLES [PERIOD]]");
    let cycles: u32 = arguments.next().map_or(10_000, |n| n.parse().expect("a number"));
    let period: u8 = arguments.next().map_or(0, |n| n.parse().expect("ms"));
    let (sender, receiver, pdus) = STORAGE.try_split().expect("split once");
    let timeouts = Timeouts {
        pdu: Duration::from_millis(200),
        state_transition: Duration::from_secs(10),
        mailbox_response: Duration::from_secs(2),
        wait_loop_delay: Duration::from_millis(1),
        ..Default::default()
    };
    let master = MainDevice::new(pdus, timeouts, MainDeviceConfig::default());
    smol::block_on(async {
        smol::spawn(ethercrab::std::tx_rx_task(&interface, sender, receiver).expect("interface"))
            .detach();
        let mut group = master
            .init_single_group::<16, 256>(ethercat_now)
            .await
            .expect("scan");
        let mut found = Vec::new();
        for slave in group.iter(&master) {
            let identity = slave.identity();
            let name = slave.sdo_read::<heapless::String<64>>(0x1008, 0).await;
            let delay = slave.register_read::<u32>(0x0928_u16).await.expect("0928h");
            found.push(format!(
                "{{\"name\": \"{}\", \"device\": \"{}\", \"vendor\": {}, \"product\": {}, \"revision\": {}, \"delay\": {delay}}}",
                slave.name(),
                name.map(|text| text.to_string()).unwrap_or_default(),
                identity.vendor_id,
                identity.product_id,
                identity.revision,
            ));
        }
        let (mut wrong, mut expected, mut times) = (0, 0, Vec::new());
        let mut sizes = Vec::new();
        if period == 0 {
            let group = group.into_op(&master).await.expect("OP");
            for s in group.iter(&master) {
                sizes.push(format!("[{}, {}]", s.outputs_raw().len(), s.inputs_raw().len()));
            }
            for _ in 0..cycles {
                let reply = group.tx_rx(&master).await.expect("process data");
                expected = expected.max(reply.working_counter);
                wrong += u32::from(reply.working_counter != 3 * sizes.len() as u16);
            }
        } else {
            for mut slave in group.iter_mut(&master) {
                slave.sdo_write(0x60C2, 1, period).await.expect("60C2h");
                slave.set_dc_sync(DcSync::Sync0);
            }
            let period = Duration::from_millis(period.into());
            let clock = DcConfiguration {
                start_delay: Duration::from_millis(100),
                sync0_period: period,
                sync0_shift: period / 2,
            };
            let group = group.into_pre_op_pdi(&master).await.expect("PRE-OP");
            let group = group.configure_dc_sync(&master, clock).await.expect("SYNC0");
            let group = group.into_safe_op(&master).await.expect("SAFE-OP");
            let group = group.request_into_op(&master).await.expect("OP asked for");
            for s in group.iter(&master) {
                sizes.push(format!("[{}, {}]", s.outputs_raw().len(), s.inputs_raw().len()));
            }
            let (mut until_op, mut seen) = (1000, 0);
            while seen < cycles {
                let now = Instant::now();
                let reply = group.tx_rx_dc(&master).await.expect("process data");
                if seen > 0 || reply.all_op() {
                    seen += 1;
                    expected = expected.max(reply.working_counter);
                    let right = reply.all_op() && reply.working_counter == 3 * sizes.len() as u16;
                    wrong += u32::from(!right);
                    times.push(reply.extra.dc_system_time.to_string());
                } else {
                    until_op -= 1;
                    assert!(until_op > 0, "no OP: {:?}", reply.subdevice_states);
                }
                smol::Timer::at(now + reply.extra.next_cycle_wait).await;
            }
        }
        println!(
            "{{\"slaves\": [{}], \"sizes\": [{}], \"cycles\": {cycles}, \"wrong\": {wrong}, \"wkc\": {expected}, \"times\": [{}]}}",
            found.join(", "),
            sizes.join(", "),
            times.join(", "),
        );
    });
}
