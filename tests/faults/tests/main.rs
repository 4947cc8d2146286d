//! The fault campaign.

mod fleet;
mod planted;
mod schedules;
mod shards;
