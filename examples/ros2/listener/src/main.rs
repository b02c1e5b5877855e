//! Hears a Tilth daemon with `[zenoh] ros = true` as a node of ROS 2 does: first what there is, then one message of each.
//!
//!     tilth-ros2-listener tcp/127.0.0.1:7447 0 /jd7930_parker500

use std::time::{Duration, Instant};

use hiroz::{Builder, MessageTypeInfo, Result, context::ZContextBuilder, msg::SerdeCdrSerdes};
use hiroz_msgs::{
    diagnostic_msgs::DiagnosticArray, nav_msgs::Odometry, sensor_msgs::NavSatFix, std_msgs::Header, tf2_msgs::TFMessage,
};
use serde::{Deserialize, Serialize};

const PATIENCE: Duration = Duration::from_secs(60);

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "tilth_msgs/msg/SoilTireParameter")]
pub struct SoilTireParameter {
    pub name: String,
    pub status: u8,
    pub value: f64,
    pub sd: f64,
    pub per_mass: f64,
    pub age: f64,
    pub reason: String,
}

impl hiroz::msg::ZMessage for SoilTireParameter {
    type Serdes = SerdeCdrSerdes<SoilTireParameter>;
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "tilth_msgs/msg/SoilTireEstimate")]
pub struct SoilTireEstimate {
    pub header: Header,
    pub machine: String,
    pub method: String,
    pub parameters: [SoilTireParameter; 6],
    pub log_covariance: Vec<f64>,
}

impl hiroz::msg::ZMessage for SoilTireEstimate {
    type Serdes = SerdeCdrSerdes<SoilTireEstimate>;
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, endpoint, domain, namespace] = arguments.as_slice() else {
        eprintln!("give an endpoint, a domain and a namespace");
        std::process::exit(2);
    };
    let context = ZContextBuilder::default()
        .with_mode("peer")
        .disable_multicast_scouting()
        .with_connect_endpoints([endpoint.as_str()])
        .with_domain_id(domain.parse().expect("a number"))
        .build()?;
    let node = context.create_node("listener").without_parameters().build()?;
    let odometry = node.create_sub::<Odometry>(&format!("{namespace}/tractor/odometry")).build()?;
    let transforms = node.create_sub::<TFMessage>("/tf").build()?;
    let fix = node.create_sub::<NavSatFix>(&format!("{namespace}/gnss/tractor_front/fix")).build()?;
    let diagnostics = node.create_sub::<DiagnosticArray>("/diagnostics").build()?;
    let estimate = node.create_sub::<SoilTireEstimate>(&format!("{namespace}/soil_tire")).build()?;

    let began = Instant::now();
    let known = || context.graph().get_node_names().iter().any(|(name, _)| name == "tilth");
    while !known() && began.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(20));
    }
    for (name, at) in context.graph().get_node_names() {
        println!("node {at} {name}");
    }
    let mut topics = context.graph().get_topic_names_and_types();
    topics.sort();
    for (topic, kind) in topics {
        println!("topic {topic} {kind}");
    }
    println!("listening");
    let one = odometry.recv_timeout(PATIENCE)?;
    let (at, turned) = (&one.pose.pose.position, &one.pose.pose.orientation);
    println!("odometry {} {} {:.3} {:.3} {:.6} {:.6}", one.header.frame_id, one.child_frame_id, at.x, at.y, turned.z, turned.w);
    for row in transforms.recv_timeout(PATIENCE)?.transforms {
        println!("transform {} {}", row.header.frame_id, row.child_frame_id);
    }
    let one = fix.recv_timeout(PATIENCE)?;
    println!("fix {} {:.7} {:.7}", one.header.frame_id, one.latitude, one.longitude);
    let one = estimate.recv_timeout(PATIENCE)?;
    println!("estimate {} {} {}", one.machine, one.method, one.header.stamp.sec);
    for row in &one.parameters {
        println!("parameter {} {} {:.1} {}", row.name, row.status, row.value, row.reason);
    }
    let one = diagnostics.recv_timeout(PATIENCE)?;
    for row in one.status {
        println!("diagnostic {} {} {}", row.level, row.name, row.message);
    }
    Ok(())
}
