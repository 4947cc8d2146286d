//! The fault campaign.

mod planted;
mod schedules;
mod shards;
