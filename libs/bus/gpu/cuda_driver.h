#pragma once

#include <cuda.h>

#include <string>

namespace splatbus::bus::gpu {

/// The driver's virtual-memory functions, looked up at run time, so that a program built with CUDA also starts on a
/// machine without a driver. Needs CUDA 12.5 or newer to build, a driver of 12.0 or newer to run.
struct Driver {
  decltype(&cuGetErrorString) error_string;
  decltype(&cuMemGetAllocationGranularity) granularity;
  decltype(&cuMemCreate) create;
  decltype(&cuMemRelease) release;
  decltype(&cuMemExportToShareableHandle) export_handle;
  decltype(&cuMemImportFromShareableHandle) import_handle;
  decltype(&cuMemGetAllocationPropertiesFromHandle) properties;
  decltype(&cuMemAddressReserve) reserve;
  decltype(&cuMemAddressFree) free_address;
  decltype(&cuMemMap) map;
  decltype(&cuMemUnmap) unmap;
  decltype(&cuMemSetAccess) set_access;

  /// Makes the first device and its primary context current to this thread. Throws Error when there is no usable
  /// device.
  static const Driver& get();

  /// Throws Error with `what` and the driver's words.
  void check(CUresult result, const std::string& what) const;
};

}  // namespace splatbus::bus::gpu
