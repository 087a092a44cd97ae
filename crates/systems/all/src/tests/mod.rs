mod keys;
mod list;
mod load;
mod memory;
mod network_table;
