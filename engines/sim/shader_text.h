#pragma once

namespace splatbus::sim {

/// GLSL without the version and the defines, which shaders.cpp puts in front.
extern const char* const kVertexShader;
extern const char* const kFragmentShader;
extern const char* const kResolveVertexShader;
extern const char* const kResolveFragmentShader;

}  // namespace splatbus::sim
