//! The binary, from the command line to what it leaves on disk. Each test has a folder of its own;
//! none changes the environment or the current directory of this process.

mod bad_input;
mod beats;
mod checking;
mod checkpoints;
mod commands;
mod config_errors;
mod config_keys;
mod eval;
mod fine_tuning;
mod goals;
mod imports;
mod newcomer;
mod own_system;
mod plans;
mod preparation;
mod previews;
mod records;
mod reports;
mod resume;
mod run_folders;
mod sizes;
mod stages;
mod train;
mod view;
