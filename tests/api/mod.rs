//! The service over HTTP: the real server on a free port.

mod access;
mod browser;
mod crash;
mod dashboard;
mod deltas;
mod drag;
mod durable;
mod edits;
mod engine;
mod errors;
mod events;
mod faults;
mod fuzz;
mod glb;
mod idle;
mod jobs;
mod layers;
mod lightmap;
mod load;
mod moves;
mod openapi;
mod process;
mod render;
mod scenes;
mod server;
mod shutdown;
