//! ethercrab brings the slaves at an interface to OP and runs cycles; prints one line of JSON.

use ethercrab::{std::ethercat_now, MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use std::{env, time::Duration};

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

fn main() {
    let mut arguments = env::args().skip(1);
    let interface = arguments.next().expect("usage: reach-op INTERFACE [CYCLES]");
    let cycles: u32 = arguments.next().map_or(10_000, |n| n.parse().expect("a number"));
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
        let group = master
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
        let group = group.into_op(&master).await.expect("OP");
        let sizes: Vec<String> = group
            .iter(&master)
            .map(|s| format!("[{}, {}]", s.outputs_raw().len(), s.inputs_raw().len()))
            .collect();
        let (mut wrong, mut expected) = (0, 0);
        for _ in 0..cycles {
            let reply = group.tx_rx(&master).await.expect("process data");
            expected = expected.max(reply.working_counter);
            wrong += u32::from(reply.working_counter != 3 * sizes.len() as u16);
        }
        println!(
            "{{\"slaves\": [{}], \"sizes\": [{}], \"cycles\": {cycles}, \"wrong\": {wrong}, \"wkc\": {expected}}}",
            found.join(", "),
            sizes.join(", "),
        );
    });
}
