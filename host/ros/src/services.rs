//! The services `arm`, `disarm` and `stop`, each on a thread of its own: an arm that waits does
//! not delay a stop.

use futures::executor::block_on;

use crate::{
    RunError,
    arguments::Arguments,
    attendance::Attendance,
    message::TriggerResponse,
    node::{Node, start as start_thread},
};

pub(crate) fn start(
    node: &mut Node,
    arguments: &Arguments,
    attendance: &Attendance,
) -> Result<(), RunError> {
    if arguments.publish_only {
        return Ok(());
    }
    serve(node, "arm", attendance, Attendance::arm)?;
    serve(node, "disarm", attendance, Attendance::disarm)?;
    serve(node, "stop", attendance, Attendance::stop)
}

fn serve(
    node: &mut Node,
    name: &'static str,
    attendance: &Attendance,
    obey: impl Fn(&Attendance) -> Result<(), String> + Send + 'static,
) -> Result<(), RunError> {
    let server = node.trigger(name)?;
    let attendance = attendance.clone();
    start_thread(name, move || {
        loop {
            let request = match block_on(server.async_receive_request()) {
                Ok((request, _)) => request,
                Err(error) => {
                    tracing::warn!("{name}: {error}");
                    continue;
                }
            };
            let done = obey(&attendance);
            match &done {
                Ok(()) => tracing::info!("{name}: done"),
                Err(error) => tracing::warn!("{name}: {error}"),
            }
            let answer = TriggerResponse {
                success: done.is_ok(),
                message: done.err().unwrap_or_default(),
            };
            if let Err(error) = server.send_response(request, answer) {
                tracing::warn!("{name}: the answer is not sent: {error}");
            }
        }
    })
}
