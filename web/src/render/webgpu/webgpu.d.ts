// What TypeScript's own types of WebGPU leave out.
declare const GPUBufferUsage: Readonly<
  Record<'MAP_READ' | 'COPY_SRC' | 'COPY_DST' | 'INDEX' | 'UNIFORM' | 'STORAGE' | 'INDIRECT', GPUBufferUsageFlags>
>;
declare const GPUTextureUsage: Readonly<Record<'COPY_SRC' | 'TEXTURE_BINDING' | 'RENDER_ATTACHMENT', GPUTextureUsageFlags>>;
declare const GPUMapMode: Readonly<Record<'READ', GPUMapModeFlags>>;

interface HTMLCanvasElement {
  getContext(kind: 'webgpu'): GPUCanvasContext | null;
}
