#pragma once

namespace splatbus::sim {

/// GLSL without the version and the defines, which shaders.cpp puts in front.
extern const char* const kVertexShader;
extern const char* const kFragmentShader;
/// Boxes of the objects that are asked for: whichever is seen is marked.
extern const char* const kBoxVertexShader;
extern const char* const kBoxFragmentShader;
/// Gives each command an instance where its object is marked, else none.
extern const char* const kInstanceShader;
extern const char* const kResolveVertexShader;
extern const char* const kResolveFragmentShader;

}  // namespace splatbus::sim
