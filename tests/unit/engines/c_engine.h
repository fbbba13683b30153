#ifndef SPLATBUS_TEST_C_ENGINE_H
#define SPLATBUS_TEST_C_ENGINE_H

#ifdef __cplusplus
extern "C" {
#endif

/* An engine in plain C: joins the bus, waits for one camera, submits a frame of it and leaves. 0, or the step that
 * failed. */
int run_c_engine(const char* address, int patience_ms);

#ifdef __cplusplus
}
#endif
#endif
