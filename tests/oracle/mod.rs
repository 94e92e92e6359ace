//! The engine against closed forms, independent computations and full bakes.

mod ambient;
mod building;
mod determinism;
mod edits;
mod enclosures;
mod focus;
mod hard_cases;
mod layers;
mod many_lights;
mod panes;
mod paper;
mod path;
mod plates;
mod scenes;
mod screens;
mod see_through;
mod skies;
mod stated;
mod statistics;
mod tiles;
