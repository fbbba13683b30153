// What the page uses of WebXR, which TypeScript's own library does not have.
interface XRRigidTransform {
  /** Column-major 4x4. */
  readonly matrix: Float32Array;
  readonly inverse: XRRigidTransform;
}
interface XRView {
  readonly eye: 'left' | 'right' | 'none';
  /** Column-major 4x4, of OpenGL's clip space. */
  readonly projectionMatrix: Float32Array;
  readonly transform: XRRigidTransform;
}
interface XRViewerPose {
  readonly transform: XRRigidTransform;
  readonly views: readonly XRView[];
}
interface XRReferenceSpace extends EventTarget {}
interface XRFrame {
  getViewerPose(space: XRReferenceSpace): XRViewerPose | undefined;
}
interface XRInputSource {
  readonly handedness: 'none' | 'left' | 'right';
  readonly gamepad?: Gamepad;
}
interface XRSession extends EventTarget {
  readonly inputSources: Iterable<XRInputSource>;
  updateRenderState(state: { baseLayer: XRWebGLLayer }): Promise<void> | void;
  requestReferenceSpace(type: 'local'): Promise<XRReferenceSpace>;
  requestAnimationFrame(callback: (nowMs: number, frame: XRFrame) => void): number;
  end(): Promise<void>;
}
interface XRWebGLLayer {
  readonly framebuffer: WebGLFramebuffer | null;
  getViewport(view: XRView): { x: number; y: number; width: number; height: number } | undefined;
}
declare const XRWebGLLayer: { new (session: XRSession, gl: WebGL2RenderingContext, options: { antialias: boolean; depth: boolean }): XRWebGLLayer };
interface XRSystem {
  isSessionSupported(mode: 'immersive-vr'): Promise<boolean>;
  requestSession(mode: 'immersive-vr'): Promise<XRSession>;
}
interface Navigator {
  readonly xr?: XRSystem;
}
