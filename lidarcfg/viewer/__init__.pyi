from .camera import Camera as Camera
from .contents import Contents as Contents
from .contents import load_contents as load_contents
from .page import page_of as page_of
from .page import save_html as save_html
from .server import Server as Server
from .still import save_still as save_still
from .window import show_window as show_window
