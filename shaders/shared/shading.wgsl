// All that turns a hit into a material.

//!include rays
//!include scene
//!include math
//!include sampler
//!include texture
//!include surface
